//! `pseudoflow ablate`: the paper's tables by other data. Every row is a training with its own settings, from the same
//! weights, for every seed; each result is scored on a test split. What was done is not done again.

use super::adapt;
use anyhow::{Context as _, Result, bail, ensure};
use clap::{Args as _, Parser};
use pseudoflow_cli::progress::progress_bar;
use pseudoflow_cli::training::{FOLDER, files};
use pseudoflow_evaluator::{Report, Scores};
use serde::Deserialize;
use serde_yaml::Value;
use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode};

/// A column of the table: its name and its score.
type Column = (&'static str, fn(&Scores) -> f64);
const SCORES: [Column; 5] = [
    ("add_s_recall_0.1d", |scores| scores.add_s_recall),
    ("auc_add_s", |scores| scores.auc_add_s),
    ("mssd_recall", |scores| scores.mssd_recall),
    ("mspd_recall", |scores| scores.mspd_recall),
    ("vsd_recall", |scores| scores.vsd_recall),
];
/// The poses that are scored, as `report.json` calls them.
const REFINED: &str = "refined";
const WITH_TRUTH: &str = "pseudoflow-with-truth";

#[derive(clap::Args)]
pub(crate) struct Args {
    /// What to compare, e.g. config/ablations/tabletop.yaml.
    file: PathBuf,
    /// Folder of the trainings, their scores and the table.
    #[arg(long, default_value = "out/ablation")]
    out: PathBuf,
}

/// The file. Options are those of `pseudoflow adapt`, without their dashes and with `_` for `-`.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Ablation {
    /// Options of every training: `bag`, `objects`, `weights`, `steps`, ...
    adapt: BTreeMap<String, Value>,
    /// Options of every evaluation: `dataset`, `split`, ...
    eval: BTreeMap<String, Value>,
    seeds: Vec<u64>,
    rows: Vec<Row>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Row {
    name: String,
    /// What differs in this row.
    #[serde(default)]
    adapt: BTreeMap<String, Value>,
    /// Folder of `SCENE/scene_gt.json`: a supervised training, by `pseudoflow-with-truth`.
    truth: Option<PathBuf>,
}

/// Options of adapt about how labels are made, which a supervised training has no use for.
fn of_labels() -> Vec<String> {
    let command = adapt::LabelArgs::augment_args(clap::Command::new("adapt"));
    command.get_arguments().map(|option| option.get_id().to_string()).collect()
}

/// Only needed to try the options of a row before hours of work.
#[derive(Parser)]
struct Options {
    #[command(flatten)]
    _adapt: adapt::Args,
}

fn words(options: &BTreeMap<String, Value>) -> Result<Vec<String>> {
    let mut words = Vec::new();
    for (name, value) in options {
        let flag = format!("--{}", name.replace('_', "-"));
        let values = match value {
            Value::Bool(false) => continue,
            Value::Bool(true) => vec![],
            Value::Sequence(all) => all.iter().map(scalar).collect::<Result<_>>()?,
            one => vec![scalar(one)?],
        };
        words.push(flag);
        words.extend(values);
    }
    Ok(words)
}

fn scalar(value: &Value) -> Result<String> {
    match value {
        Value::String(text) => Ok(text.clone()),
        Value::Number(number) => Ok(number.to_string()),
        other => bail!("{other:?} is no value of an option: write a text, a number, or a list of them"),
    }
}

/// One training.
struct Job<'a> {
    row: &'a Row,
    seed: u64,
    options: BTreeMap<String, Value>,
    folder: PathBuf,
}

impl Job<'_> {
    fn weights(&self) -> PathBuf {
        self.folder.join("weights.safetensors")
    }

    fn checkpoint(&self) -> PathBuf {
        self.weights().with_extension(FOLDER).join(files::CHECKPOINT)
    }

    fn report(&self) -> PathBuf {
        self.folder.join("report.json")
    }

    fn adapt_words(&self) -> Result<Vec<String>> {
        let mut words = words(&self.options)?;
        words.extend(["--out".into(), self.weights().display().to_string()]);
        words.extend(["--seed".into(), self.seed.to_string()]);
        Ok(words)
    }

    /// The command that trains; the options that only one of the two programs has stay with it.
    fn training(&self) -> Result<Command> {
        let own = std::env::current_exe().context("this program's path")?;
        let resume = self.checkpoint().is_file().then_some("--resume");
        let Some(truth) = &self.row.truth else {
            let mut command = Command::new(own);
            command.arg("adapt").arg("--unjudged").args(resume).args(self.adapt_words()?);
            return Ok(command);
        };
        let program = own.with_file_name(WITH_TRUTH);
        ensure!(program.is_file(), "{}: not there: build the whole workspace", program.display());
        let mut options = self.options.clone();
        options.retain(|name, _| !of_labels().contains(name));
        let supervised = Job { row: self.row, seed: self.seed, options, folder: self.folder.clone() };
        let mut command = Command::new(program);
        command.arg("train").args(resume).args(supervised.adapt_words()?).arg("--truth").arg(truth);
        Ok(command)
    }

    fn scoring(&self, options: &BTreeMap<String, Value>) -> Result<Command> {
        let text = |name: &str, default: &str| options.get(name).map_or(Ok(default.to_owned()), scalar);
        let (dataset, split) = (text("dataset", "dataset")?, text("split", "test")?);
        let dataset = Path::new(&dataset).canonicalize().with_context(|| format!("`eval: {{dataset: {dataset}}}`"))?;
        let dataset = dataset.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let csv = self.folder.join(format!("pseudoflow_{dataset}-{}.csv", split.replace('_', "-")));
        let mut command = Command::new(std::env::current_exe().context("this program's path")?);
        command.arg("eval").args(words(options)?).arg("--weights").arg(self.weights());
        command.arg("--csv").arg(csv).arg("--report").arg(&self.folder);
        Ok(command)
    }

    fn run(&self, eval: &BTreeMap<String, Value>) -> Result<()> {
        std::fs::create_dir_all(&self.folder).with_context(|| format!("{}", self.folder.display()))?;
        if !self.weights().is_file() {
            logged(self.training()?, &self.folder.join("train.log"))?;
        }
        if !self.report().is_file() {
            logged(self.scoring(eval)?, &self.folder.join("eval.log"))?;
        }
        Ok(())
    }

    fn scores(&self) -> Result<[f64; SCORES.len()]> {
        let path = self.report();
        let report = Report::read_json(&path)?;
        let scores = report.overall.get(REFINED);
        let scores = scores.with_context(|| format!("{}: no scores of `{REFINED}` poses", path.display()))?;
        Ok(SCORES.map(|(_, score)| score(scores)))
    }
}

/// Runs a command with its words in a file, and fails with the last of them.
fn logged(mut command: Command, log: &Path) -> Result<()> {
    let file = std::fs::File::create(log).with_context(|| format!("{}", log.display()))?;
    let errors = file.try_clone().with_context(|| format!("{}", log.display()))?;
    let status = command.stdout(file).stderr(errors).status().with_context(|| format!("{command:?}"))?;
    if !status.success() {
        let said = std::fs::read_to_string(log).unwrap_or_default();
        let last: Vec<&str> = said.lines().rev().take(5).collect();
        bail!("{status}; {} ends with:\n{}", log.display(), last.into_iter().rev().collect::<Vec<_>>().join("\n"));
    }
    Ok(())
}

pub(crate) fn run(args: &Args) -> Result<ExitCode> {
    let name = args.file.display();
    let text = std::fs::read_to_string(&args.file).with_context(|| format!("{name}"))?;
    let ablation: Ablation = serde_yaml::from_str(&text).with_context(|| format!("{name}"))?;
    ensure!(!ablation.seeds.is_empty() && !ablation.rows.is_empty(), "{name}: give `seeds` and `rows`");
    let jobs = jobs(&ablation, &args.out)?;
    let bar = progress_bar(jobs.len() as u64, "trainings");
    for job in &jobs {
        bar.set_message(format!("{} (seed {})", job.row.name, job.seed));
        job.run(&ablation.eval).with_context(|| format!("row `{}`, seed {}", job.row.name, job.seed))?;
        bar.inc(1);
        // Hours may pass until the next row: what is known is on the disk.
        write_table(&ablation, &jobs, &args.out)?;
    }
    bar.finish_and_clear();
    print!("{}", write_table(&ablation, &jobs, &args.out)?);
    println!("{}", args.out.join("ablation.csv").display());
    Ok(ExitCode::SUCCESS)
}

/// All trainings, row by row within a seed: an interrupted ablation has whole seeds to compare.
fn jobs<'a>(ablation: &'a Ablation, out: &Path) -> Result<Vec<Job<'a>>> {
    let mut jobs = Vec::new();
    for seed in &ablation.seeds {
        for row in &ablation.rows {
            let mut options = ablation.adapt.clone();
            options.extend(row.adapt.clone());
            let folder: String = row.name.chars().map(|c| if c.is_ascii_alphanumeric() { c } else { '_' }).collect();
            let job = Job { row, seed: *seed, options, folder: out.join(folder).join(format!("seed_{seed}")) };
            let words = job.adapt_words()?;
            Options::try_parse_from(std::iter::once("adapt".to_owned()).chain(words))
                .with_context(|| format!("row `{}`", row.name))?;
            if let Some(other) = jobs.iter().find(|other: &&Job<'_>| other.folder == job.folder) {
                bail!("rows `{}` and `{}` would share {}: rename one", other.row.name, row.name, job.folder.display());
            }
            jobs.push(job);
        }
    }
    Ok(jobs)
}

/// `ablation.csv` with a line for each training that is scored; returns the rows' means and spreads to print.
fn write_table(ablation: &Ablation, jobs: &[Job<'_>], out: &Path) -> Result<String> {
    let mut csv = format!("row,seed,{}\n", SCORES.map(|(name, _)| name).join(","));
    let names: String = SCORES.iter().map(|(name, _)| format!(" {name:>17}")).collect();
    let mut text = format!("{:32} {:>5}{names}\n", "row", "seeds");
    for row in &ablation.rows {
        let done = jobs.iter().filter(|job| std::ptr::eq(job.row, row) && job.report().is_file());
        let scores = done.map(|job| Ok((job.seed, job.scores()?))).collect::<Result<Vec<_>>>()?;
        for (seed, scores) in &scores {
            let numbers: Vec<String> = scores.iter().map(f64::to_string).collect();
            writeln!(csv, "{},{seed},{}", row.name, numbers.join(","))?;
        }
        write!(text, "{:32} {:>5}", row.name, scores.len())?;
        for column in 0..SCORES.len() {
            let (mean, spread) = mean_and_spread(&scores.iter().map(|(_, s)| s[column]).collect::<Vec<_>>());
            write!(text, " {:>17}", format!("{mean:.3} +- {spread:.3}"))?;
        }
        text.push('\n');
    }
    let path = out.join("ablation.csv");
    pseudoflow_files::write(&path, csv.as_bytes()).with_context(|| format!("{}: cannot be written", path.display()))?;
    Ok(text)
}

/// Mean and standard deviation of a sample; no spread for one.
fn mean_and_spread(values: &[f64]) -> (f64, f64) {
    let n = values.len() as f64;
    let mean = values.iter().sum::<f64>() / n;
    let squares: f64 = values.iter().map(|v| (v - mean).powi(2)).sum();
    (mean, if values.len() > 1 { (squares / (n - 1.0)).sqrt() } else { 0.0 })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ablation(rows: &str) -> Ablation {
        let text = format!(
            "adapt: {{bag: [a, b], objects: o, weights: w, steps: 10}}\neval: {{dataset: d}}\nseeds: [1, 2]\nrows:\n{rows}"
        );
        serde_yaml::from_str(&text).unwrap()
    }

    #[test]
    fn rows_become_options_of_adapt_and_bad_ones_are_named() {
        let good = ablation("- {name: all labels, adapt: {accept_all_labels: true, photo_weight: 0}}");
        let jobs = jobs(&good, Path::new("out")).unwrap();
        assert_eq!(jobs.len(), 2);
        assert_eq!(jobs[1].folder, Path::new("out/all_labels/seed_2"));
        let words = jobs[0].adapt_words().unwrap().join(" ");
        assert!(words.starts_with("--accept-all-labels --bag a b --objects o --photo-weight 0 --steps 10"), "{words}");
        let bad = ablation("- {name: typo, adapt: {photo_wait: 0}}");
        let error = format!("{:#}", super::jobs(&bad, Path::new("out")).err().unwrap());
        assert!(error.contains("typo") && error.contains("photo-wait"), "{error}");
        let twice = ablation("- {name: a b}\n- {name: a_b}");
        let error = super::jobs(&twice, Path::new("out")).err().unwrap().to_string();
        assert!(error.contains("`a b` and `a_b`"), "{error}");
    }

    #[test]
    fn spread_is_that_of_a_sample() {
        let (mean, spread) = mean_and_spread(&[0.7, 0.8, 0.9]);
        assert!((mean - 0.8).abs() < 1e-12 && (spread - 0.1).abs() < 1e-12);
        assert_eq!(mean_and_spread(&[0.5]), (0.5, 0.0));
    }
}
