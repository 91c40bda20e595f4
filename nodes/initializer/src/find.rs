//! From an image to detections: the network's votes, and where there is a comparer the views that resemble it.

use crate::compare::{CoarseMatch, Comparer, Match, Photograph, Preparing};
use crate::detect::{DetectConfig, Detection, Hypothesis, Rectangle, detect, solve, suppress};
use crate::network::DetectorNetwork;
use crate::votes::{Vote, group, place, sureness, votes};
use crate::{Fit, InitializerError};
use pseudoflow_geometry::Intrinsics;
use pseudoflow_imaging::{Object, ObjectSet, RgbImage};
use rand::Rng;
use std::collections::BTreeMap;

/// Places of an object that get a first look, the surest: a network that was trained little sees an object in many places.
const MOST_COARSE: usize = 12;
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

impl Finder {
    /// The objects that cannot be searched for yet.
    pub(crate) fn preparing(&self) -> Vec<Preparing> {
        self.comparer.as_ref().map_or_else(Vec::new, Comparer::preparing)
    }

    /// Prepares a little of what is missing.
    ///
    /// # Errors
    /// What engine and renderer say.
    pub(crate) fn prepare_some(&mut self) -> Result<(), InitializerError> {
        let objects = &self.objects;
        self.comparer.as_mut().map_or(Ok(()), |comparer| comparer.prepare_some(objects).map(drop))
    }

    /// Where the network sees objects in an image. It costs the same whatever is searched for.
    ///
    /// # Errors
    /// What the engine says.
    pub(crate) fn look(&mut self, image: &RgbImage) -> Result<Seen, InitializerError> {
        let fit = self.network.fit(image.width(), image.height());
        let answer = self.network.run(&fit.input(image))?;
        let groups = group(&votes(&answer, self.config.min_vote as f32));
        Ok(Seen { groups, ids: answer.object_ids.to_vec(), fit })
    }

    /// The objects in an image that was looked at, the surest first. With a comparer, which is dear, those are left out that
    /// `expected` says of where they are seen.
    ///
    /// # Errors
    /// What engine, renderer and solver say.
    pub(crate) fn find(
        &mut self,
        seen: Seen,
        image: &RgbImage,
        camera: &Intrinsics,
        expected: &dyn Fn(&Object, &Rectangle) -> bool,
        rng: &mut impl Rng,
    ) -> Result<Vec<Detection>, InitializerError> {
        let Seen { groups, ids, fit } = seen;
        let Some(comparer) = &mut self.comparer else {
            return detect(&groups, &ids, &self.objects, &fit.intrinsics(camera), &self.config, rng);
        };
        let (objects, config) = (&self.objects, &self.config);
        Search { comparer, objects, config, ids: &ids, photograph: Photograph { image, camera }, fit }
            .find(groups, expected, rng)
    }
}

/// What the network's votes say of an image.
pub(crate) struct Seen {
    groups: Vec<Vec<Vote>>,
    /// Objects by class.
    ids: Vec<u32>,
    fit: Fit,
}

impl Seen {
    /// Whether an object may be in the image.
    pub(crate) fn shows(&self, object_id: u32, config: &DetectConfig) -> bool {
        self.groups.iter().any(|votes| self.ids[votes[0].class] == object_id && is_sure(votes, config))
    }
}

/// A search of one image for what resembles the views of the objects.
struct Search<'a> {
    comparer: &'a mut Comparer,
    objects: &'a ObjectSet,
    config: &'a DetectConfig,
    /// Objects by class.
    ids: &'a [u32],
    photograph: Photograph<'a>,
    fit: Fit,
}

/// Where an object may be.
struct Place<'a> {
    object: &'a Object,
    votes: Vec<Vote>,
    coarse_match: CoarseMatch,
}

impl Place<'_> {
    /// How sure the votes are, times how similar the best view is.
    fn promise(&self) -> f64 {
        sureness(&self.votes) * self.coarse_match.similarity()
    }
}

impl<'a> Search<'a> {
    fn find(
        mut self,
        groups: Vec<Vec<Vote>>,
        expected: &dyn Fn(&Object, &Rectangle) -> bool,
        rng: &mut impl Rng,
    ) -> Result<Vec<Detection>, InitializerError> {
        let (mut found, mut compared) = (Vec::new(), BTreeMap::new());
        for place in self.places(groups, expected)? {
            let count = compared.entry(place.object.id).or_insert(0);
            if *count < self.config.max_instances + SPARE {
                *count += 1;
                found.extend(self.compare(&place, rng)?);
            }
        }
        Ok(suppress(found, self.config.max_instances))
    }

    /// Where the objects may be, the most promising places first.
    fn places(
        &mut self,
        groups: Vec<Vec<Vote>>,
        expected: &dyn Fn(&Object, &Rectangle) -> bool,
    ) -> Result<Vec<Place<'a>>, InitializerError> {
        let (mut places, mut coarse_matches) = (Vec::new(), vec![0; self.ids.len()]);
        for votes in sure_groups(groups, self.config) {
            let class = votes[0].class;
            let (object, there) = (self.objects.get(self.ids[class])?, self.in_image(&place(&votes)));
            if coarse_matches[class] < MOST_COARSE && !expected(object, &there) {
                coarse_matches[class] += 1;
                let coarse_match = self.comparer.coarse_match(&self.photograph, object, &there)?;
                places.push(Place { object, votes, coarse_match });
            }
        }
        places.sort_by(|a, b| b.promise().total_cmp(&a.promise()));
        Ok(places)
    }

    /// A place of the input as one of the image.
    fn in_image(&self, there: &Rectangle) -> Rectangle {
        let pixels_of_image = self.photograph.camera.fx / self.fit.intrinsics(self.photograph.camera).fx;
        Rectangle { middle_px: self.fit.image_from_input(&there.middle_px), size_px: there.size_px * pixels_of_image }
    }

    /// The views that resemble best what is seen at a place.
    fn compare(&mut self, at: &Place<'_>, rng: &mut impl Rng) -> Result<Option<Detection>, InitializerError> {
        let (score, there) = (sureness(&at.votes), place(&at.votes));
        let best = self.comparer.best(&self.photograph, at.object, &at.coarse_match)?;
        let hypothesis = |m: Match| Hypothesis {
            camera_from_object: m.camera_from_object,
            score: score * m.similarity.clamp(0.0, 1.0),
        };
        let mut poses: Vec<Hypothesis> = best.into_iter().map(hypothesis).collect();
        let Some(first) = poses.first().copied() else { return Ok(None) };
        // What the votes themselves say may be righter than any view, but is less often so.
        let voted = solve(&at.votes, at.object, &self.fit.intrinsics(self.photograph.camera), self.config, rng)?;
        poses.extend(
            voted.map(|d| Hypothesis { camera_from_object: d.camera_from_object, score: d.score.min(first.score) }),
        );
        Ok(Some(Detection {
            object_id: at.object.id,
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
    groups.retain(|votes| is_sure(votes, config));
    groups.sort_by(|a, b| sureness(b).total_cmp(&sureness(a)));
    groups
}

fn is_sure(votes: &[Vote], config: &DetectConfig) -> bool {
    votes.len() >= config.min_votes && sureness(votes) >= config.min_score
}
