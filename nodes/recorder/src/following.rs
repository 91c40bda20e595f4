//! Which object `/object_pose` is about, kept on disk: a recorder that was killed goes on with the same one.

use crate::RecorderConfig;
use pseudoflow_msgs::ObjectPose;
use pseudoflow_msgs::ros::{Followed, Follower, Naming};
use pseudoflow_runtime::{Context, NodeError};
use std::path::PathBuf;

/// A [`Follower`] whose state outlives the process.
pub(crate) struct Following {
    follower: Follower,
    kept: PathBuf,
}

impl Following {
    pub(crate) fn open(config: &RecorderConfig, naming: &Naming, context: &Context) -> Result<Self, NodeError> {
        let wanted = config.object.as_deref().map(|name| naming.wanted(name)).transpose()?;
        let mut follower = Follower::new(wanted, (config.switch_after_s * 1e9) as i64);
        let kept = context.out_dir.join(format!("{}.followed", context.name));
        if context.restarts > 0 {
            follower.resume(std::fs::read_to_string(&kept).ok().and_then(|text| read(&text)));
        }
        Ok(Self { follower, kept })
    }

    /// The pose for `/object_pose`. The state is written before the frame is: asked again after a death in between, the
    /// follower answers the same.
    pub(crate) fn choose<'a>(
        &mut self,
        stamp_ns: i64,
        poses: &'a [ObjectPose],
    ) -> Result<Option<&'a ObjectPose>, NodeError> {
        let before = self.follower.state();
        let chosen = self.follower.choose(stamp_ns, poses);
        if let Some(state) = self.follower.state().filter(|state| before != Some(*state)) {
            std::fs::create_dir_all(self.kept.parent().unwrap_or(&self.kept))?;
            std::fs::write(&self.kept, write(state))?;
        }
        Ok(chosen)
    }
}

fn write(Followed { identity: (object_id, instance), seen_ns }: Followed) -> String {
    format!("{object_id} {instance} {seen_ns} .\n")
}

/// `None` of a text that was cut off.
fn read(text: &str) -> Option<Followed> {
    let mut words = text.split_whitespace();
    let identity = (words.next()?.parse().ok()?, words.next()?.parse().ok()?);
    let followed = Followed { identity, seen_ns: words.next()?.parse().ok()? };
    (words.next() == Some(".")).then_some(followed)
}

#[cfg(test)]
mod tests {
    use super::*;
    use bytemuck::Zeroable;

    fn context(folder: &std::path::Path, restarts: u32) -> Context {
        Context { name: "recorder".into(), seed: 1, out_dir: folder.to_owned(), restarts, replay: true }
    }

    fn pose(object_id: u32, score: f64) -> ObjectPose {
        ObjectPose { object_id, score, ..ObjectPose::zeroed() }
    }

    #[test]
    fn another_life_follows_the_same_object() {
        let folder = tempfile::tempdir().unwrap();
        let config = RecorderConfig::new(folder.path().join("run"));
        let open = |restarts| Following::open(&config, &Naming::default(), &context(folder.path(), restarts)).unwrap();
        let first = [pose(3, 0.5)];
        let later = [pose(2, 0.9), pose(3, 0.5)];
        assert_eq!(open(0).choose(1, &first).unwrap(), Some(&first[0]));
        assert_eq!(open(1).choose(2, &later).unwrap(), Some(&later[1]));
        assert_eq!(open(0).choose(3, &later).unwrap(), Some(&later[0]));
        assert_eq!(read("3 0 12"), None);
    }

    #[test]
    fn an_object_that_nobody_knows_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let config = RecorderConfig { object: Some("teapot".into()), ..RecorderConfig::new(folder.path().join("run")) };
        let naming = Naming::new([(1, "cup".to_owned())].into()).unwrap();
        let error = Following::open(&config, &naming, &context(folder.path(), 0)).err().unwrap().to_string();
        assert!(error.contains("teapot") && error.contains("cup"), "{error}");
    }
}
