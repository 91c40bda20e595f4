//! Trains the initializer as a JSON file says: `cargo run --release --workspace --example initializer -- run.json`

use pseudoflow_pretraining::initializer::{InitializerTraining, train_initializer};
use pseudoflow_pretraining::offline::TerminalProgress;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    env_logger::Builder::from_env(env_logger::Env::default().default_filter_or("info")).init();
    let path = std::env::args().nth(1).ok_or("usage: initializer run.json")?;
    let config: InitializerTraining = serde_json::from_str(&std::fs::read_to_string(path)?)?;
    let summary = train_initializer(&config, &mut TerminalProgress::new()?)?;
    eprintln!("{}", serde_json::to_string_pretty(&summary)?);
    Ok(())
}
