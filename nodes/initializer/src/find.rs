//! From an image to detections: the network's votes, and where there is a comparer the views that resemble it.

use crate::compare::{Comparer, Glance};
use crate::detect::{DetectConfig, Detection, Hypothesis, Rectangle, detect, solve, suppress};
use crate::network::DetectorNetwork;
use crate::votes::{Vote, group, place, sureness, votes};
use crate::{Fit, InitializerError};
use pseudoflow_geometry::Intrinsics;
use pseudoflow_imaging::{Object, ObjectSet, RgbImage};
use rand::Rng;

/// Places of an object that get a first look, the surest: a network that was trained little sees an object in many places.
const GLANCES: usize = 12;
/// So many more of them are compared than an object may have instances, which is dear: the most promising is not always the
/// right one.
const SPARE: usize = 1;

/// Finds the objects of a set in images.
pub(crate) struct Finder {
    pub(crate) network: DetectorNetwork,
    pub(crate) comparer: Option<Comparer>,
    pub(crate) objects: ObjectSet,
    pub(crate) config: DetectConfig,
}

/// An image and its camera.
struct Seen<'a> {
    image: &'a RgbImage,
    camera: &'a Intrinsics,
    fit: Fit,
}

/// Where an object may be.
struct Place {
    votes: Vec<Vote>,
    glance: Glance,
    /// How sure the votes are, times how similar the best view is.
    promise: f64,
}

impl Seen<'_> {
    /// A place of the input as one of the image.
    fn in_image(&self, there: &Rectangle) -> Rectangle {
        let pixels_of_image = self.camera.fx / self.fit.intrinsics(self.camera).fx;
        Rectangle { middle_px: self.fit.image_from_input(&there.middle_px), size_px: there.size_px * pixels_of_image }
    }
}

impl Finder {
    /// The objects in an image, the surest first. With a comparer, which is dear, those are left out that are expected where
    /// they are seen.
    ///
    /// # Errors
    /// What engine, renderer and solver say.
    pub(crate) fn find(
        &mut self,
        image: &RgbImage,
        camera: &Intrinsics,
        expected: &dyn Fn(&Object, &Rectangle) -> bool,
        rng: &mut impl Rng,
    ) -> Result<Vec<Detection>, InitializerError> {
        let seen = Seen { image, camera, fit: self.network.fit(image.width(), image.height()) };
        let answer = self.network.run(&seen.fit.input(image))?;
        let groups = group(&votes(&answer, self.config.min_vote as f32));
        let ids = answer.object_ids.to_vec();
        if self.comparer.is_none() {
            return detect(&groups, &ids, &self.objects, &seen.fit.intrinsics(camera), &self.config, rng);
        }
        let mut found = Vec::new();
        let mut compared = vec![0; ids.len()];
        for place in self.promising(&seen, groups, &ids, expected)? {
            let count = &mut compared[place.votes[0].class];
            if *count < self.config.max_instances + SPARE {
                *count += 1;
                found.extend(self.compare(&seen, ids[place.votes[0].class], &place, rng)?);
            }
        }
        Ok(suppress(found, self.config.max_instances))
    }

    /// Where the objects may be, the most promising places first.
    fn promising(
        &mut self,
        seen: &Seen<'_>,
        groups: Vec<Vec<Vote>>,
        ids: &[u32],
        expected: &dyn Fn(&Object, &Rectangle) -> bool,
    ) -> Result<Vec<Place>, InitializerError> {
        let Some(comparer) = &mut self.comparer else { return Ok(Vec::new()) };
        let (mut places, mut glances) = (Vec::new(), vec![0; ids.len()]);
        for votes in sure_groups(groups, &self.config) {
            let (class, there) = (votes[0].class, seen.in_image(&place(&votes)));
            let object = self.objects.get(ids[class])?;
            if glances[class] < GLANCES && !expected(object, &there) {
                glances[class] += 1;
                let glance = comparer.glance(seen.image, object, &there)?;
                places.push(Place { promise: sureness(&votes) * glance.similarity(), votes, glance });
            }
        }
        places.sort_by(|a, b| b.promise.total_cmp(&a.promise));
        Ok(places)
    }

    /// The views that resemble best what is seen where votes say that an object is.
    fn compare(
        &mut self,
        seen: &Seen<'_>,
        object_id: u32,
        candidate: &Place,
        rng: &mut impl Rng,
    ) -> Result<Option<Detection>, InitializerError> {
        let Some(comparer) = &mut self.comparer else { return Ok(None) };
        let votes = &candidate.votes;
        let (object, score, there) = (self.objects.get(object_id)?, sureness(votes), place(votes));
        let views = comparer.best(seen.image, seen.camera, object, &candidate.glance)?;
        let mut poses: Vec<Hypothesis> = views
            .into_iter()
            .map(|m| Hypothesis {
                camera_from_object: m.camera_from_object,
                score: score * m.similarity.clamp(0.0, 1.0),
            })
            .collect();
        let Some(first) = poses.first().copied() else { return Ok(None) };
        // What the votes themselves say may be righter than any view, but is less often so.
        let voted = solve(votes, object, &seen.fit.intrinsics(seen.camera), &self.config, rng)?;
        poses.extend(
            voted.map(|d| Hypothesis { camera_from_object: d.camera_from_object, score: d.score.min(first.score) }),
        );
        Ok(Some(Detection {
            object_id,
            camera_from_object: first.camera_from_object,
            score: first.score,
            centre_px: there.middle_px,
            side_px: there.side_px(),
            covariance: [0.0; 36],
            others: poses.split_off(1),
        }))
    }
}

/// The groups of votes that are sure enough to be an instance, the surest first.
fn sure_groups(mut groups: Vec<Vec<Vote>>, config: &DetectConfig) -> Vec<Vec<Vote>> {
    groups.retain(|votes| votes.len() >= config.min_votes && sureness(votes) >= config.min_score);
    groups.sort_by(|a, b| sureness(b).total_cmp(&sureness(a)));
    groups
}
