//! What a graph found, as files that a scoring reads: poses as a BOP result file, and what else is known of them.

mod details;

pub use details::{ImageDetails, details_of_estimates, read_details};

use pseudoflow_geometry::pose_from_quaternion;
use pseudoflow_metrics::{Estimate, ResultsWriter};
use pseudoflow_msgs::{GateDecision, GateDecisions, ObjectPose, ObjectPoses};
use pseudoflow_runtime::{Context, Inputs, JsonLines, Node, NodeError, OrBadInput, Outputs, Port, PortSpec, Role};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

const POSES: Port<ObjectPoses<'static>> = Port::required("poses");
const DECISIONS: Port<GateDecisions<'static>> = Port::optional("decisions");

/// Settings of the results node.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct ResultsConfig {
    /// The BOP result file, METHOD_DATASET-SPLIT.csv. It grows image by image as `.csv.part` and gets its name at the end. `time`
    /// is what passed from the source to here: with `window: 1` in one process, the work of the nodes between.
    pub csv: Option<PathBuf>,
    /// File that gets a line of JSON for each image: covariances and the gate's decisions (port `decisions`).
    pub details: Option<PathBuf>,
    /// Goes on with the files of an interrupted run; images that the result file has already are left out.
    pub append: bool,
}

/// Writes the likeliest pose of each instance, equal ones once.
pub struct ResultsNode {
    /// The file, where it will lie at the end, and the images in it.
    csv: Option<(ResultsWriter, PathBuf)>,
    done: BTreeSet<(u32, u32)>,
    details: Option<JsonLines>,
}

/// Where a result file grows.
fn part(csv: &Path) -> PathBuf {
    csv.with_extension("csv.part")
}

impl ResultsNode {
    fn open_csv(&mut self, csv: PathBuf, append: bool) -> Result<(), NodeError> {
        let (writer, kept) = match append {
            true => ResultsWriter::append(&part(&csv))?,
            false => (ResultsWriter::create(&part(&csv))?, Vec::new()),
        };
        self.done = kept.iter().map(|estimate| (estimate.scene_id, estimate.image_id)).collect();
        self.csv = Some((writer, csv));
        Ok(())
    }
}

fn estimate(image: (u32, u32), pose: &ObjectPose, image_time_s: Option<f64>) -> Result<Estimate, NodeError> {
    let camera_from_object =
        pose_from_quaternion(&pose.rotation_xyzw, &pose.translation_m).or_bad_input(POSES.name())?;
    Ok(Estimate {
        scene_id: image.0,
        image_id: image.1,
        object_id: pose.object_id,
        score: pose.score,
        camera_from_object: camera_from_object.into(),
        image_time_s,
    })
}

/// A result file may not hold a pose of an object twice: two instances that begin alike can end alike.
fn without_repeats<'a>(poses: impl Iterator<Item = &'a ObjectPose>) -> Vec<ObjectPose> {
    let mut kept: Vec<ObjectPose> = Vec::new();
    for pose in poses {
        let is_same = |other: &ObjectPose| {
            (other.object_id, other.rotation_xyzw, other.translation_m)
                == (pose.object_id, pose.rotation_xyzw, pose.translation_m)
        };
        if !kept.iter().any(is_same) {
            kept.push(*pose);
        }
    }
    kept
}

fn make_folder_of(file: &Path) -> Result<(), NodeError> {
    match file.parent() {
        Some(folder) => {
            std::fs::create_dir_all(folder).map_err(|error| format!("{}: {error}", folder.display()).into())
        }
        None => Ok(()),
    }
}

impl Node for ResultsNode {
    const KIND: &'static str = "results";
    const ROLE: Role = Role::Sink;
    const KEEPS: bool = true;
    type Config = ResultsConfig;

    fn inputs() -> Vec<PortSpec> {
        vec![POSES.spec(), DECISIONS.spec()]
    }

    fn outputs() -> Vec<PortSpec> {
        Vec::new()
    }

    fn check(config: &ResultsConfig) -> Result<(), NodeError> {
        if config.csv.is_none() && config.details.is_none() {
            return Err("neither `csv` nor `details`: name a file to write".into());
        }
        match config.csv.iter().chain(&config.details).find(|path| path.file_name().is_none()) {
            Some(path) => Err(format!("`{}`: give the name of a file", path.display()).into()),
            None => Ok(()),
        }
    }

    fn create(config: ResultsConfig, context: &Context) -> Result<Self, NodeError> {
        let append = config.append || context.restarts > 0;
        config.csv.as_deref().map(make_folder_of).transpose()?;
        let details = config.details.as_deref().map(|path| JsonLines::open(path, append)).transpose()?;
        let mut node = Self { csv: None, done: BTreeSet::new(), details };
        config.csv.map_or(Ok(()), |csv| node.open_csv(csv, append))?;
        Ok(node)
    }

    fn process(&mut self, inputs: &dyn Inputs, _: &mut dyn Outputs, _: &Context) -> Result<(), NodeError> {
        let message = POSES.read(inputs)?;
        let image = (message.header.scene_id, message.header.image_id);
        if self.done.contains(&image) {
            return Ok(());
        }
        let decisions: &[GateDecision] = DECISIONS.given(inputs)?.map_or(&[][..], |message| message.decisions);
        let poses = without_repeats(ObjectPose::likeliest(message.poses));
        if let Some(details) = &mut self.details {
            // Before the poses: an image whose poses are there is whole.
            details.write(&ImageDetails::new(image, &poses, decisions))?;
        }
        if let Some((writer, _)) = &mut self.csv {
            let time_s = Some(inputs.age_ns()).filter(|ns| *ns > 0).map(|ns| ns as f64 * 1e-9);
            let estimates: Vec<_> = poses.iter().map(|pose| estimate(image, pose, time_s)).collect::<Result<_, _>>()?;
            writer.write_image(&estimates)?;
        }
        Ok(())
    }

    fn finish(&mut self, _: &Context) -> Result<(), NodeError> {
        let Some((_, csv)) = self.csv.take() else { return Ok(()) };
        std::fs::rename(part(&csv), &csv)
            .map_err(|error| format!("{}: cannot be written: {error}", csv.display()).into())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use pseudoflow_metrics::read_results;
    use pseudoflow_msgs::FrameKey;
    use pseudoflow_runtime::InMemory;

    fn context(restarts: u32) -> Context {
        Context { name: "results".into(), seed: 1, out_dir: "/".into(), restarts, replay: true }
    }

    fn frame(image_id: u32) -> InMemory {
        let zeroed: ObjectPose = bytemuck::Zeroable::zeroed();
        let pose = |instance, score| ObjectPose {
            object_id: 7,
            instance,
            source: pseudoflow_msgs::PoseSource::Refined as u32,
            score,
            translation_m: [0.0, 0.0, 1.0 + f64::from(instance.min(1))],
            rotation_xyzw: [0.0, 0.0, 0.0, 1.0],
            ..zeroed
        };
        // The second is another hypothesis, the last repeats the third.
        let poses = [pose(0, 0.9), pose(0, 0.8), pose(1, 0.7), pose(2, 0.6)];
        let decision: GateDecision = bytemuck::Zeroable::zeroed();
        let decision = GateDecision {
            object_id: 7,
            accepted: 1,
            before_rotation_xyzw: [0.0, 0.0, 0.0, 1.0],
            after_rotation_xyzw: [0.0, 0.0, 1.0, 0.0],
            evidence: [0.1; GateDecision::EVIDENCE.len()],
            ..decision
        };
        let key = FrameKey { index: u64::from(image_id), stamp_ns: 0 };
        let mut messages = InMemory::new(key);
        messages
            .send("poses", key, ObjectPoses::byte_len(poses.len()), &mut |b| ObjectPoses::write(b, 2, image_id, &poses))
            .unwrap();
        let len = GateDecisions::byte_len(1);
        messages.send("decisions", key, len, &mut |b| GateDecisions::write(b, &[decision])).unwrap();
        messages
    }

    #[test]
    fn an_interrupted_run_goes_on_and_no_image_comes_twice() {
        let folder = tempfile::tempdir().unwrap();
        let (csv, details) = (folder.path().join("new/a_b-test.csv"), folder.path().join("d.jsonl"));
        let config = ResultsConfig { csv: Some(csv.clone()), details: Some(details.clone()), append: false };
        let mut first = ResultsNode::create(config.clone(), &context(0)).unwrap();
        first.process(&frame(1), &mut InMemory::default(), &context(0)).unwrap();
        drop(first); // killed
        let mut second = ResultsNode::create(config, &context(1)).unwrap();
        for image_id in [1, 4] {
            second.process(&frame(image_id), &mut InMemory::default(), &context(1)).unwrap();
        }
        assert!(!csv.exists(), "the run has not ended");
        second.finish(&context(1)).unwrap();
        let found = read_results(&csv, None).unwrap();
        let rows: Vec<_> = found.iter().map(|e| (e.scene_id, e.image_id, e.score)).collect();
        assert_eq!(rows, [(2, 1, 0.9), (2, 1, 0.7), (2, 4, 0.9), (2, 4, 0.7)]);
        let of_estimates = details_of_estimates(&found, &[read_details(&details).unwrap()]).unwrap();
        assert_eq!(of_estimates.iter().map(|d| d.gate.len()).collect::<Vec<_>>(), [1, 0, 1, 0]);
        assert_eq!(of_estimates[2].confidence, Some(0.9));
        assert!(of_estimates[2].gate[0].accepted && of_estimates[2].gate[0].evidence["better"] == 0.1);
    }
}
