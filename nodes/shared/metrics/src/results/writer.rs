use super::{Estimate, HEADER, ResultsError, parse_results};
use std::fs::{File, OpenOptions};
use std::io::Write;
use std::path::{Path, PathBuf};

/// `METHOD_DATASET-SPLIT.csv`, e.g. `pseudoflow_ycbv-test.csv`; the split may have a type (`test-primesense`).
///
/// # Errors
/// When a part is empty or has characters by which the toolkit would split the name wrongly.
pub fn file_name(method: &str, dataset: &str, split: &str) -> Result<String, ResultsError> {
    for (part, name, dashes) in [("METHOD", method, true), ("DATASET", dataset, false), ("SPLIT", split, true)] {
        let allowed = |c: char| c.is_ascii_alphanumeric() || (dashes && c == '-') || c == '.';
        if name.is_empty() || !name.chars().all(allowed) {
            return Err(ResultsError::Name { part, name: name.to_owned() });
        }
    }
    Ok(format!("{method}_{dataset}-{split}.csv"))
}

/// Writes a whole result file, sorted by scene and image.
///
/// # Errors
/// When the file cannot be written, or estimates of an image have different times.
pub fn write_results(path: &Path, estimates: &[Estimate]) -> Result<(), ResultsError> {
    let mut writer = ResultsWriter::create(path)?;
    let mut sorted = estimates.to_vec();
    sorted.sort_by_key(|e| (e.scene_id, e.image_id));
    for image in sorted.chunk_by(|a, b| (a.scene_id, a.image_id) == (b.scene_id, b.image_id)) {
        writer.write_image(image)?;
    }
    Ok(())
}

/// Writes a result file image by image, and goes on with one that was interrupted.
#[derive(Debug)]
pub struct ResultsWriter {
    path: PathBuf,
    file: File,
}

impl ResultsWriter {
    /// Starts a file with its header; what was there is lost.
    ///
    /// # Errors
    /// When it cannot be written.
    pub fn create(path: &Path) -> Result<Self, ResultsError> {
        let io = |source| ResultsError::Io { path: path.to_owned(), source };
        let mut file = File::create(path).map_err(io)?;
        file.write_all(format!("{HEADER}\n").as_bytes()).map_err(io)?;
        Ok(Self { path: path.to_owned(), file })
    }

    /// Goes on with a file that may have been cut off anywhere; creates it if there is none. The rows of its last
    /// image are removed, as some may be missing; returns the rows that stay.
    ///
    /// # Errors
    /// When the file cannot be read or written, or one of the rows that stay is bad.
    pub fn resume(path: &Path) -> Result<(Self, Vec<Estimate>), ResultsError> {
        if !path.exists() {
            return Ok((Self::create(path)?, Vec::new()));
        }
        Self::go_on(path, without_last_image)
    }

    /// As [`ResultsWriter::resume`] for a file of a writer that died between two images: only a row that was cut off is removed.
    ///
    /// # Errors
    /// As [`ResultsWriter::resume`].
    pub fn append(path: &Path) -> Result<(Self, Vec<Estimate>), ResultsError> {
        if !path.exists() {
            return Ok((Self::create(path)?, Vec::new()));
        }
        Self::go_on(path, whole_rows)
    }

    fn go_on(path: &Path, kept: fn(&str) -> &str) -> Result<(Self, Vec<Estimate>), ResultsError> {
        let io = |source| ResultsError::Io { path: path.to_owned(), source };
        let text = std::fs::read_to_string(path).map_err(io)?;
        let kept = kept(&text);
        if !kept.starts_with(HEADER) {
            return Ok((Self::create(path)?, Vec::new()));
        }
        let estimates =
            parse_results(kept, None).map_err(|problems| ResultsError::Lines { path: path.to_owned(), problems })?;
        let file = OpenOptions::new().append(true).open(path).map_err(io)?;
        file.set_len(kept.len() as u64).map_err(io)?;
        Ok((Self { path: path.to_owned(), file }, estimates))
    }

    /// Appends the rows of one image.
    ///
    /// # Errors
    /// When the file cannot be written or the times differ.
    pub fn write_image(&mut self, estimates: &[Estimate]) -> Result<(), ResultsError> {
        let Some(first) = estimates.first() else { return Ok(()) };
        let same = |e: &Estimate| {
            (e.scene_id, e.image_id, e.image_time_s) == (first.scene_id, first.image_id, first.image_time_s)
        };
        if !estimates.iter().all(same) {
            return Err(ResultsError::ImageTimes { scene_id: first.scene_id, image_id: first.image_id });
        }
        let rows: String = estimates.iter().map(row).collect();
        let io = |source| ResultsError::Io { path: self.path.clone(), source };
        self.file.write_all(rows.as_bytes()).and_then(|()| self.file.flush()).map_err(io)
    }
}

/// The text without a last row that was cut off.
fn whole_rows(text: &str) -> &str {
    &text[..text.rfind('\n').map_or(0, |i| i + 1)]
}

/// The text up to the first row of the image that its last whole row belongs to.
fn without_last_image(text: &str) -> &str {
    let whole = whole_rows(text);
    let image = |line: &str| line.splitn(3, ',').take(2).map(str::to_owned).collect::<Vec<_>>();
    let Some(last) = whole.lines().last().map(image) else { return whole };
    let rows = whole.split_inclusive('\n').rev().take_while(|l| !l.starts_with(HEADER) && image(l) == last);
    &whole[..whole.len() - rows.map(str::len).sum::<usize>()]
}

fn row(e: &Estimate) -> String {
    let join = |values: &[f64]| values.iter().map(f64::to_string).collect::<Vec<_>>().join(" ");
    let translation_mm = e.camera_from_object.translation_m() * 1e3;
    format!(
        "{},{},{},{},{},{},{}\n",
        e.scene_id,
        e.image_id,
        e.object_id,
        e.score,
        join(e.camera_from_object.matrix().transpose().as_slice()),
        join(translation_mm.as_slice()),
        e.image_time_s.unwrap_or(-1.0)
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::read_results;
    use nalgebra::{Translation3, UnitQuaternion, Vector3};
    use proptest::prelude::*;
    use pseudoflow_geometry::{Pose, rotation_angle_rad};

    fn estimate(image_id: u32, object_id: u32) -> Estimate {
        let turn = UnitQuaternion::from_scaled_axis(Vector3::new(0.1, f64::from(image_id), f64::from(object_id)));
        Estimate {
            scene_id: 1,
            image_id,
            object_id,
            score: 1.0,
            camera_from_object: Pose::from_parts(Translation3::new(0.1, 0.2, 0.9), turn).into(),
            image_time_s: Some(0.3),
        }
    }

    proptest! {
        #[test]
        fn what_is_written_is_read(angles in prop::array::uniform3(-3.0..3.0), t in prop::array::uniform3(-5.0..5.0),
                                   score in 0.0..1.0, time in prop::option::of(0.0..9.0)) {
            let pose = Pose::from_parts(Vector3::from(t).into(), UnitQuaternion::from_scaled_axis(Vector3::from(angles)));
            let e = Estimate { camera_from_object: pose.into(), score, image_time_s: time, ..estimate(4, 5) };
            let dir = tempfile::tempdir().unwrap();
            let path = dir.path().join("m_d-test.csv");
            write_results(&path, std::slice::from_ref(&e)).unwrap();
            let back = read_results(&path, None).unwrap().remove(0);
            prop_assert!(rotation_angle_rad(&back.camera_from_object.pose(), &pose) < 1e-7);
            prop_assert!((back.camera_from_object.translation_m() - pose.translation.vector).norm() < 1e-12);
            prop_assert_eq!((back.score, back.image_time_s, back.image_id), (e.score, e.image_time_s, 4));
        }
    }

    #[test]
    fn an_interrupted_file_is_taken_up_before_its_last_image() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("m_d-test.csv");
        write_results(&path, &[estimate(1, 1), estimate(1, 2), estimate(2, 1), estimate(2, 2)]).unwrap();
        let whole = std::fs::read_to_string(&path).unwrap();
        for cut in 0..whole.len() {
            std::fs::write(&path, &whole[..cut]).unwrap();
            let (mut writer, kept) = ResultsWriter::resume(&path).unwrap();
            assert!(kept.iter().all(|e| e.image_id == 1) && [0, 2].contains(&kept.len()), "cut at {cut}");
            if kept.is_empty() {
                writer.write_image(&[estimate(1, 1), estimate(1, 2)]).unwrap();
            }
            writer.write_image(&[estimate(2, 1), estimate(2, 2)]).unwrap();
            assert_eq!(std::fs::read_to_string(&path).unwrap(), whole, "cut at {cut}");
        }
    }

    #[test]
    fn different_times_in_an_image_are_refused() {
        let dir = tempfile::tempdir().unwrap();
        let other = Estimate { image_time_s: Some(0.4), ..estimate(1, 2) };
        let result = write_results(&dir.path().join("m_d-test.csv"), &[estimate(1, 1), other]);
        assert!(matches!(result, Err(ResultsError::ImageTimes { image_id: 1, .. })));
    }

    #[test]
    fn names_that_would_be_split_wrongly_are_refused() {
        assert_eq!(
            file_name("pseudo-flow", "tless", "test-primesense").unwrap(),
            "pseudo-flow_tless-test-primesense.csv"
        );
        assert!(file_name("my_method", "lmo", "test").is_err());
        assert!(file_name("m", "lm-o", "test").is_err());
        assert!(file_name("", "lmo", "test").is_err());
    }
}
