//! What a detector says about images: it may come late. Each image that went on is remembered for `memory_s`, so that an answer
//! finds its frame by the stamp; no image waits for one.

use crate::ledger::Ledger;
use pseudoflow_edge::rectangle_of;
use pseudoflow_msgs::ros::{Detection2DArray, Detection3DArray, Header, Naming, object_poses};
use pseudoflow_msgs::{CameraFrameHeader, FrameKey, ObjectPose, Rectangle};
use std::collections::VecDeque;
use std::time::{Duration, Instant};

/// Most detections of one message that are used, the surest first.
const MOST_DETECTIONS: usize = 64;
/// Most answers that wait for their image.
const MOST_EARLY: usize = 64;
/// An answer waits for its image at least so long: a small message overtakes a large one.
const LEAST_PATIENCE: Duration = Duration::from_secs(1);
/// No object is farther away.
const FARTHEST_M: f64 = 1000.0;

/// An image that went on.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Remembered {
    pub(crate) key: FrameKey,
    pub(crate) header: CameraFrameHeader,
    /// Its pixels, where the graph looks at rectangles of the past.
    pub(crate) rgb: Option<Vec<u8>>,
}

impl Remembered {
    fn size(&self) -> (u32, u32) {
        (self.header.width, self.header.height)
    }
}

/// Most memory for pixels of the past.
const MOST_BYTES: usize = 256 << 20;

/// The images of the last seconds.
#[derive(Debug)]
pub(crate) struct Memory {
    keep_ns: i64,
    images: VecDeque<Remembered>,
}

impl Memory {
    pub(crate) fn new(keep_s: f64) -> Self {
        Self { keep_ns: (keep_s * 1e9) as i64, images: VecDeque::new() }
    }

    pub(crate) fn remember(&mut self, image: Remembered) {
        let stamp_ns = image.key.stamp_ns;
        // A clock that jumped back begins anew.
        self.images.retain(|old| (0..=self.keep_ns).contains(&stamp_ns.saturating_sub(old.key.stamp_ns)));
        self.images.push_back(image);
        let bytes = |images: &VecDeque<Remembered>| images.iter().flat_map(|i| &i.rgb).map(Vec::len).sum::<usize>();
        while bytes(&self.images) > MOST_BYTES {
            self.images.pop_front();
        }
    }

    pub(crate) fn holds(&self, key: FrameKey) -> bool {
        self.images.iter().any(|image| image.key == key)
    }

    /// An image that is remembered.
    pub(crate) fn image_of(&self, key: FrameKey) -> Option<&Remembered> {
        self.images.iter().find(|image| image.key == key)
    }

    /// The image of a stamp; why there is none otherwise.
    fn image(&self, stamp_ns: i64) -> Result<&Remembered, Unmatched> {
        let newest = self.images.back().map(|image| image.key.stamp_ns);
        let found = self.images.iter().find(|image| image.key.stamp_ns == stamp_ns);
        found.ok_or(match newest {
            Some(newest) if stamp_ns <= newest && newest.saturating_sub(stamp_ns) > self.keep_ns => Unmatched::Old,
            Some(newest) if stamp_ns <= newest => Unmatched::Never,
            _ => Unmatched::Early,
        })
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Unmatched {
    /// Its image is forgotten.
    Old,
    /// No image of its stamp went on.
    Never,
    /// Its image has not come yet, if ever.
    Early,
}

/// A detector's message.
pub(crate) trait Answer: Sized {
    /// What the house makes of one detection.
    type Found;
    fn header(&self) -> &Header;
    /// Whether it says that nothing was found.
    fn is_empty(&self) -> bool;
    fn found(&self, image: &Remembered, naming: &Naming, topic: &str, ledger: &mut Ledger) -> Vec<Self::Found>;
}

/// Finds the image of each answer.
#[derive(Debug)]
pub(crate) struct Matcher<A> {
    topic: String,
    early: VecDeque<(Instant, A)>,
    /// How long an answer waits for its image.
    patience: Duration,
}

impl<A: Answer> Matcher<A> {
    /// For answers on a topic to images that are remembered for `keep_s`.
    pub(crate) fn new(topic: String, keep_s: f64) -> Self {
        let patience = LEAST_PATIENCE.max(Duration::from_secs_f64(keep_s));
        Self { topic, early: VecDeque::new(), patience }
    }

    pub(crate) fn push(&mut self, answer: A, ledger: &mut Ledger) {
        self.early.push_back((Instant::now(), answer));
        if self.early.len() > MOST_EARLY {
            self.give_up_oldest(ledger);
        }
    }

    fn give_up_oldest(&mut self, ledger: &mut Ledger) {
        if self.early.pop_front().is_some() {
            const CAUSE: &str = "no image of this stamp has come: stamp detections with their image's stamp";
            ledger.drop(&self.topic, "future", CAUSE);
        }
    }

    /// The next answer whose image is known, with what it says of it. One that says something, but nothing that can be used, is
    /// no answer: another may follow.
    pub(crate) fn take(
        &mut self,
        memory: &Memory,
        naming: &Naming,
        ledger: &mut Ledger,
    ) -> Option<(FrameKey, Vec<A::Found>)> {
        let mut at = 0;
        while at < self.early.len() {
            let stamp_ns = self.early[at].1.header().stamp.as_ns();
            let matched = memory.image(stamp_ns);
            if matched == Err(Unmatched::Early) {
                at += 1;
                continue;
            }
            let (_, answer) = self.early.remove(at)?;
            match matched {
                Err(Unmatched::Old) => ledger.drop(&self.topic, "late", "its image is older than `camera.memory_s`"),
                Err(_) => ledger.drop(&self.topic, "stamp", format!("no image has the stamp {stamp_ns} ns")),
                Ok(image) if answer.header().frame_id != image.header.frame_id() => {
                    let (theirs, ours) = (&answer.header().frame_id, image.header.frame_id());
                    ledger.drop(&self.topic, "frame_id", format!("`{theirs}` is not the image's frame `{ours}`"));
                }
                Ok(image) => {
                    let found = answer.found(image, naming, &self.topic, ledger);
                    if answer.is_empty() || !found.is_empty() {
                        return Some((image.key, found));
                    }
                }
            }
        }
        while self.early.front().is_some_and(|(came, _)| came.elapsed() >= self.patience) {
            self.give_up_oldest(ledger);
        }
        None
    }
}

impl Answer for Detection3DArray {
    type Found = ObjectPose;

    fn header(&self) -> &Header {
        &self.header
    }

    fn is_empty(&self) -> bool {
        self.detections.is_empty()
    }

    fn found(&self, _: &Remembered, naming: &Naming, topic: &str, ledger: &mut Ledger) -> Vec<ObjectPose> {
        let (poses, errors) = object_poses(self, naming);
        errors.iter().for_each(|error| ledger.drop(topic, error.kind(), error));
        let usable = poses.into_iter().filter_map(|pose| match usable(pose, naming) {
            Ok(pose) => Some(mended(pose, naming, topic, ledger)),
            Err((kind, cause)) => {
                ledger.drop(topic, kind, cause);
                None
            }
        });
        let usable = usable.collect();
        surest(usable, |pose: &ObjectPose| pose.score, topic, ledger)
    }
}

/// A pose that can be before the camera, of an object of the set.
fn usable(pose: ObjectPose, naming: &Naming) -> Result<ObjectPose, (&'static str, String)> {
    let name = naming.class_id(pose.object_id);
    if !naming.is_known(pose.object_id) {
        return Err(("unknown object", format!("`{name}` is not in the object set")));
    }
    let [x, y, z] = pose.translation_m;
    if !(z > 0.0 && x.abs().max(y.abs()).max(z) < FARTHEST_M) {
        return Err(("pose", format!("`{name}` at ({x}, {y}, {z}) m cannot be before the camera")));
    }
    Ok(pose)
}

/// The pose with a score in 0..1 and a covariance that is one, or zero; what is given up for that is counted.
fn mended(mut pose: ObjectPose, naming: &Naming, topic: &str, ledger: &mut Ledger) -> ObjectPose {
    let name = || naming.class_id(pose.object_id);
    if !(0.0..=1.0).contains(&pose.score) {
        ledger.drop(topic, "score range", format!("the score of `{}` is {}: its pose is taken", name(), pose.score));
    }
    if !pose.covariance.iter().step_by(7).all(|variance| *variance >= 0.0) {
        ledger.drop(topic, "variance", format!("a variance of `{}` is negative: its pose is taken", name()));
        pose.covariance = [0.0; 36];
    }
    ObjectPose { score: pose.score.clamp(0.0, 1.0), ..pose }
}

fn surest<T>(mut found: Vec<T>, score: impl Fn(&T) -> f64, topic: &str, ledger: &mut Ledger) -> Vec<T> {
    let excess = found.len().saturating_sub(MOST_DETECTIONS) as u64;
    if excess > 0 {
        found.sort_by(|a, b| score(b).total_cmp(&score(a)));
        found.truncate(MOST_DETECTIONS);
        ledger.drop_many(topic, "too many", excess, format!("more than {MOST_DETECTIONS} detections in a message"));
    }
    found
}

impl Answer for Detection2DArray {
    type Found = Rectangle;

    fn header(&self) -> &Header {
        &self.header
    }

    fn is_empty(&self) -> bool {
        self.detections.is_empty()
    }

    fn found(&self, image: &Remembered, naming: &Naming, topic: &str, ledger: &mut Ledger) -> Vec<Rectangle> {
        let mut found = Vec::new();
        for detection in &self.detections {
            match rectangle_of(detection, image.size(), naming) {
                Ok(rectangle) => found.push(rectangle),
                Err(error) => ledger.drop(topic, error.kind(), error),
            }
        }
        surest(found, |r: &Rectangle| f64::from(r.score), topic, ledger)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use pseudoflow_msgs::ros::{
        BoundingBox2D, Detection2D, ObjectHypothesis, ObjectHypothesisWithPose, Point2D, Pose2D, Time,
    };

    const SECOND: i64 = 1_000_000_000;

    fn header(stamp_ns: i64) -> Header {
        Header { stamp: Time::from_ns(stamp_ns).unwrap(), frame_id: "optical".into() }
    }

    fn detection(class_id: &str, x: f64, size: f64, score: f64) -> Detection2D {
        let hypothesis = ObjectHypothesis { class_id: class_id.into(), score };
        let center = Pose2D { position: Point2D { x, y: 50.0 }, theta: 0.0 };
        Detection2D {
            results: vec![ObjectHypothesisWithPose { hypothesis, ..Default::default() }],
            bbox: BoundingBox2D { center, size_x: size, size_y: 20.0 },
            ..Default::default()
        }
    }

    fn naming() -> Naming {
        Naming::new([(5, "cup".to_owned())].into()).unwrap()
    }

    fn memory() -> Memory {
        let mut memory = Memory::new(2.0);
        for i in 0..90 {
            let key = FrameKey { index: i, stamp_ns: i as i64 * SECOND / 30 };
            let frame_id = CameraFrameHeader::frame_id_bytes("optical").unwrap();
            let header =
                CameraFrameHeader { width: 100, height: 100, scene_id: 0, image_id: 0, intrinsics: [1.0; 4], frame_id };
            memory.remember(Remembered { key, header, rgb: None });
        }
        memory
    }

    fn taken(answers: Vec<Detection2DArray>) -> (Vec<(u64, Vec<Rectangle>)>, Ledger) {
        let (mut ledger, mut matcher) = (Ledger::default(), Matcher::new("/d".into(), 2.0));
        answers.into_iter().for_each(|answer| matcher.push(answer, &mut ledger));
        let all = std::iter::from_fn(|| matcher.take(&memory(), &naming(), &mut ledger));
        let all = all.map(|(key, found)| (key.index, found)).collect();
        (all, ledger)
    }

    #[test]
    fn an_answer_finds_the_image_of_its_stamp_within_the_memory() {
        let answer = |stamp_ns| Detection2DArray {
            header: header(stamp_ns),
            detections: vec![detection("cup", 50.0, 10.0, 0.5)],
        };
        let (found, ledger) =
            taken(vec![answer(60 * SECOND / 30), answer(0), answer(2 * SECOND + 1), answer(99 * SECOND)]);
        let rectangle = Rectangle { object_id: 5, score: 0.5, left: 45.0, top: 40.0, right: 55.0, bottom: 60.0 };
        assert_eq!(found, [(60, vec![rectangle])]);
        assert_eq!((ledger.count("late"), ledger.count("stamp"), ledger.count("future")), (1, 1, 0));
        let (_, ledger) = taken(vec![answer(99 * SECOND); 100]);
        assert_eq!(ledger.count("future"), 36);
    }

    #[test]
    fn unusable_rectangles_are_counted_and_named() {
        let mut detections = vec![
            detection("cup", 50.0, 10.0, 0.5),
            detection("5", 98.0, 10.0, 7.0),
            detection("teapot", 50.0, 10.0, 0.5),
            detection("7", 50.0, 10.0, 0.5),
            detection("cup", 500.0, 10.0, 0.5),
            detection("cup", 50.0, 0.0, 0.5),
            detection("cup", f64::NAN, 10.0, 0.5),
            detection("cup", 50.0, 10.0, f64::INFINITY),
            Detection2D::default(),
        ];
        detections.extend((0..1000).map(|_| detection("cup", 50.0, 10.0, 0.1)));
        let (found, ledger) = taken(vec![Detection2DArray { header: header(2 * SECOND), detections }]);
        assert_eq!(found[0].1.len(), MOST_DETECTIONS);
        let first = found[0].1[0];
        assert_eq!((first.score, first.right), (1.0, 103.0));
        let counts =
            ["unknown object", "outside", "rectangle", "score", "empty", "too many"].map(|kind| ledger.count(kind));
        assert_eq!(counts, [2, 1, 2, 1, 1, 1002 - MOST_DETECTIONS as u64]);
    }

    #[test]
    fn poses_that_cannot_be_are_not_taken() {
        let pose = |z: f64, score: f64, variance: f64| ObjectPose {
            object_id: 5,
            instance: 0,
            status: 0,
            source: 0,
            score,
            rotation_xyzw: [0.0, 0.0, 0.0, 1.0],
            translation_m: [0.0, 0.0, z],
            covariance: [variance; 36],
        };
        assert_eq!(usable(pose(-1.0, 0.5, 0.0), &naming()).unwrap_err().0, "pose");
        assert_eq!(
            usable(ObjectPose { object_id: 6, ..pose(1.0, 0.5, 0.0) }, &naming()).unwrap_err().0,
            "unknown object"
        );
        let mut ledger = Ledger::default();
        let mended = mended(usable(pose(1.0, 7.0, -1.0), &naming()).unwrap(), &naming(), "/d", &mut ledger);
        assert_eq!((mended.score, mended.covariance), (1.0, [0.0; 36]));
        assert_eq!((ledger.count("score range"), ledger.count("variance")), (1, 1));
    }

    #[test]
    fn an_answer_of_nothing_usable_leaves_its_image_to_the_next_one() {
        let answer = |detections| Detection2DArray { header: header(2 * SECOND), detections };
        let teapot = || vec![detection("teapot", 50.0, 10.0, 0.5)];
        let (found, ledger) = taken(vec![answer(teapot()), answer(vec![detection("cup", 50.0, 10.0, 0.5)])]);
        assert_eq!(found.iter().map(|(key, found)| (*key, found.len())).collect::<Vec<_>>(), [(60, 1)]);
        assert_eq!(ledger.count("unknown object"), 1);
        let (found, _) = taken(vec![answer(Vec::new())]);
        assert_eq!(found, [(60, Vec::new())], "nothing found is an answer");
    }

    #[test]
    fn an_answer_from_the_future_is_given_up_and_counted() {
        let (mut ledger, mut matcher) = (Ledger::default(), Matcher::new("/d".into(), 2.0));
        matcher.patience = Duration::ZERO;
        matcher.push(Detection2DArray { header: header(99 * SECOND), detections: Vec::new() }, &mut ledger);
        assert!(matcher.take(&memory(), &naming(), &mut ledger).is_none() && matcher.early.is_empty());
        assert_eq!(ledger.count("future"), 1);
    }
}
