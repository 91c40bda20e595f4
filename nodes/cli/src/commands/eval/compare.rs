//! The difference of two reports.

use anyhow::Result;
use pseudoflow_evaluator::{Difference, Report};
use std::path::PathBuf;
use std::process::ExitCode;

#[derive(clap::Args)]
pub(crate) struct CompareArgs {
    /// The report to begin from.
    before: PathBuf,
    /// The report to compare with it.
    after: PathBuf,
    /// The HTML page to write.
    #[arg(long, default_value = "compare.html")]
    out: PathBuf,
}

pub(crate) fn compare(args: &CompareArgs) -> Result<ExitCode> {
    let (before, after) = (Report::read_json(&args.before)?, Report::read_json(&args.after)?);
    let comparison = pseudoflow_evaluator::compare(&before, &after)?;
    comparison.write_html(&args.out)?;
    println!("{:8} {:20} {:>5} {:>7} {:>7} {:>8}  95 % interval", "object", "share", "n", "before", "after", "change");
    let rows = comparison
        .per_object
        .iter()
        .map(|(id, of)| (id.to_string(), of))
        .chain([("all".to_owned(), &comparison.overall)]);
    for (object, differences) in rows {
        for (share, d) in differences {
            let Difference { n, a, b, difference, low, high } = d;
            println!("{object:8} {share:20} {n:>5} {a:>7.3} {b:>7.3} {difference:>+8.3}  {low:+.3} .. {high:+.3}");
        }
    }
    println!("page: {}", args.out.display());
    Ok(ExitCode::SUCCESS)
}
