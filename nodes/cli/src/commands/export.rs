use anyhow::{Context as _, Result};
use pseudoflow_cli::graphs::network;
use std::path::PathBuf;
use std::process::ExitCode;

#[derive(clap::Args)]
pub(crate) struct Args {
    /// Weights, a `.safetensors` file.
    #[arg(long, value_parser = pseudoflow_runtime::shipped::input)]
    weights: PathBuf,
    /// The `.onnx` file to write.
    #[arg(long)]
    out: PathBuf,
    /// The network that they belong to: auto (as the weights say), refiner, nano, small or paper.
    #[arg(long, default_value = "auto")]
    network: String,
    /// Width and height of the crops that the network will see, pixels.
    #[arg(long, default_value_t = 128)]
    size: u32,
    /// Refinement iterations; the network's own number where absent.
    #[arg(long)]
    iterations: Option<u32>,
}

pub(crate) fn run(args: &Args) -> Result<ExitCode> {
    let network = network(&args.network)?;
    let onnx = pseudoflow_flow::load_model(&args.weights, network, args.size, args.iterations)?;
    pseudoflow_files::write(&args.out, &onnx).with_context(|| format!("{}: cannot be written", args.out.display()))?;
    println!("{}: {} bytes, {} px", args.out.display(), onnx.len(), args.size);
    Ok(ExitCode::SUCCESS)
}
