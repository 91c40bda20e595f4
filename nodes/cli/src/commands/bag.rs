use anyhow::Result;
use pseudoflow_bag::{BagReader, RecoverOptions, recover};
use pseudoflow_player::{FromBop, from_bop};
use std::path::PathBuf;
use std::process::ExitCode;

#[derive(clap::Subcommand)]
pub(crate) enum Command {
    /// Makes a recording from a BOP scene folder; image bytes stay untouched.
    FromBop {
        /// The scene folder.
        scene: PathBuf,
        /// Folder of the recording; must not exist.
        #[arg(long)]
        out: PathBuf,
        /// Takes every n-th image.
        #[arg(long, default_value_t = 1)]
        every: usize,
        /// Takes at most this many.
        #[arg(long)]
        max_frames: Option<usize>,
    },
    /// Checks a recording whole and says what it holds.
    Info {
        /// A rosbag2 folder or an .mcap file.
        bag: PathBuf,
    },
    /// Keeps what is whole of a damaged or cut-off recording.
    Recover {
        /// A rosbag2 folder or an .mcap file.
        bag: PathBuf,
        /// Folder of what is kept; must not exist. The default adds `_recovered`.
        #[arg(long)]
        out: Option<PathBuf>,
    },
}

pub(crate) fn run(command: &Command) -> Result<ExitCode> {
    match command {
        Command::FromBop { scene, out, every, max_frames } => {
            let options = FromBop { scene: scene.clone(), out: out.clone(), every: *every, max_frames: *max_frames };
            println!("{}: {} frames", out.display(), from_bop(&options)?);
        }
        Command::Info { bag } => print!("{}", BagReader::open(bag)?.info()?),
        Command::Recover { bag, out } => {
            let kept = recover(&RecoverOptions { bag: bag.clone(), out: out.clone() })?;
            println!("{}", kept.directory.display());
            kept.damages.iter().for_each(|damage| println!("  lost: {damage}"));
            kept.messages.iter().for_each(|(topic, count)| println!("  {topic}: {count} messages"));
        }
    }
    Ok(ExitCode::SUCCESS)
}
