//! Pre-training from the command line, until `pseudoflow pretrain` takes over:
//! `pretrain CONFIG.json`, the keys of `PretrainConfig`. Prints the summary as JSON.

use pseudoflow_pretraining::offline::TerminalProgress;
use pseudoflow_pretraining::pretrain::{PretrainConfig, pretrain};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    env_logger::Builder::from_env(env_logger::Env::default().default_filter_or("info")).init();
    let path = std::env::args().nth(1).ok_or("usage: pretrain CONFIG.json")?;
    let config: PretrainConfig = serde_json::from_str(&std::fs::read_to_string(path)?)?;
    let summary = pretrain(&config, &mut TerminalProgress::new()?)?;
    eprintln!("{}", serde_json::to_string_pretty(&summary)?);
    Ok(())
}
