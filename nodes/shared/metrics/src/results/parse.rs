use super::{Estimate, HEADER, Problem, ResultsError};
use crate::MatrixPose;
use std::collections::{BTreeSet, HashMap};
use std::path::Path;

/// The ids that a dataset has.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct KnownIds {
    /// Object ids.
    pub objects: BTreeSet<u32>,
    /// Scene and image ids.
    pub images: BTreeSet<(u32, u32)>,
}

/// Reads a result file. `known` is what the dataset has; without it ids are not checked.
///
/// # Errors
/// When the file cannot be read, or any line is wrong: all of them are listed with their numbers.
pub fn read_results(path: &Path, known: Option<&KnownIds>) -> Result<Vec<Estimate>, ResultsError> {
    let text = std::fs::read_to_string(path).map_err(|source| ResultsError::Io { path: path.to_owned(), source })?;
    parse_results(&text, known).map_err(|problems| ResultsError::Lines { path: path.to_owned(), problems })
}

/// Reads the text of a result file; the header is optional, as in bop_toolkit.
///
/// # Errors
/// All wrong lines (wrong number of columns, NaN, R not a rotation, unknown ids, repeated poses, times that differ
/// within an image), with line numbers from 1.
pub fn parse_results(text: &str, known: Option<&KnownIds>) -> Result<Vec<Estimate>, Vec<(usize, Problem)>> {
    let (mut estimates, mut problems, mut seen) = (Vec::new(), Vec::new(), Seen::default());
    let header = |(i, line): &(usize, &str)| *i == 0 && line.trim_start_matches('\u{feff}').trim() == HEADER;
    for (i, line) in text.lines().enumerate().filter(|l| !header(l)) {
        let checked = parse_line(line).and_then(|e| check_ids(&e, known).map(|()| e));
        match checked.and_then(|e| seen.check(&e, i + 1).map(|()| e)) {
            Ok(estimate) => estimates.push(estimate),
            Err(problem) => problems.push((i + 1, problem)),
        }
    }
    if problems.is_empty() { Ok(estimates) } else { Err(problems) }
}

fn parse_line(line: &str) -> Result<Estimate, Problem> {
    let fields: Vec<&str> = line.trim_end().split(',').collect();
    let [scene, image, object, score, rotation, translation, time] = fields[..] else {
        return Err(Problem::Columns { found: fields.len() });
    };
    let time_s = finite("time", time)?;
    Ok(Estimate {
        scene_id: id("scene_id", scene)?,
        image_id: id("im_id", image)?,
        object_id: id("obj_id", object)?,
        score: finite("score", score)?,
        camera_from_object: pose(rotation, translation)?,
        image_time_s: (time_s >= 0.0).then_some(time_s),
    })
}

fn pose(rotation: &str, translation_mm: &str) -> Result<MatrixPose, Problem> {
    let rotation: [f64; 9] = numbers("R", rotation)?;
    let translation_mm: [f64; 3] = numbers("t", translation_mm)?;
    MatrixPose::from_row_major(&rotation, &translation_mm.map(|v| v * 1e-3)).map_err(Problem::Pose)
}

fn numbers<const N: usize>(field: &'static str, text: &str) -> Result<[f64; N], Problem> {
    let values = text.split_whitespace().map(|t| finite(field, t)).collect::<Result<Vec<f64>, _>>()?;
    let found = values.len();
    values.try_into().map_err(|_| Problem::Count { field, found, expected: N })
}

fn finite(field: &'static str, text: &str) -> Result<f64, Problem> {
    let number = text.trim().parse::<f64>().ok().filter(|v| v.is_finite());
    number.ok_or_else(|| Problem::Number { field, text: text.trim().to_owned(), expected: "a finite number" })
}

fn id(field: &'static str, text: &str) -> Result<u32, Problem> {
    let expected = "a whole number from 0 up";
    text.trim().parse().map_err(|_| Problem::Number { field, text: text.trim().to_owned(), expected })
}

fn check_ids(e: &Estimate, known: Option<&KnownIds>) -> Result<(), Problem> {
    let Some(known) = known else { return Ok(()) };
    if !known.images.contains(&(e.scene_id, e.image_id)) {
        return Err(Problem::UnknownImage { scene_id: e.scene_id, image_id: e.image_id });
    }
    if !known.objects.contains(&e.object_id) {
        return Err(Problem::UnknownObject { object_id: e.object_id });
    }
    Ok(())
}

/// What earlier lines held.
#[derive(Default)]
struct Seen {
    poses: HashMap<(u32, u32, u32, [u64; 12]), usize>,
    times: HashMap<(u32, u32), (f64, usize)>,
}

impl Seen {
    fn check(&mut self, e: &Estimate, line: usize) -> Result<(), Problem> {
        let (r, t) = (e.camera_from_object.matrix(), e.camera_from_object.translation_m());
        // Adding zero makes -0 equal 0.
        let bits = std::array::from_fn(|i| if i < 9 { r[i] + 0.0 } else { t[i - 9] + 0.0 }).map(f64::to_bits);
        let first_line = *self.poses.entry((e.scene_id, e.image_id, e.object_id, bits)).or_insert(line);
        if first_line != line {
            return Err(Problem::Duplicate { first_line });
        }
        let time = e.image_time_s.unwrap_or(-1.0);
        let (first_time, first_line) = *self.times.entry((e.scene_id, e.image_id)).or_insert((time, line));
        // The toolkit's own tolerance.
        if (time - first_time).abs() > 1e-3 {
            return Err(Problem::Time { time, first_time, first_line });
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const ROW: &str = "1,2,3,0.5,1 0 0 0 1 0 0 0 1,10 20 900,0.25";

    fn problem_of(row: &str, known: Option<&KnownIds>) -> Problem {
        let mut problems = parse_results(&format!("{HEADER}\n{row}\n"), known).unwrap_err();
        assert_eq!((problems.len(), problems[0].0), (1, 2));
        problems.remove(0).1
    }

    #[test]
    fn a_row_is_read_with_and_without_header() {
        for text in [format!("{HEADER}\n{ROW}\n"), format!("{ROW}\r\n"), ROW.to_owned()] {
            let [e] = &parse_results(&text, None).unwrap()[..] else { panic!("one row") };
            assert_eq!((e.scene_id, e.image_id, e.object_id, e.score, e.image_time_s), (1, 2, 3, 0.5, Some(0.25)));
            assert!((e.camera_from_object.translation_m().z - 0.9).abs() < 1e-12);
        }
        let untimed = ROW.replace("0.25", "-1");
        assert_eq!(parse_results(&untimed, None).unwrap()[0].image_time_s, None);
    }

    #[test]
    fn each_kind_of_bad_row_is_told_apart() {
        let known = KnownIds { objects: [3].into(), images: [(1, 2)].into() };
        assert!(parse_results(ROW, Some(&known)).is_ok());
        assert_eq!(problem_of("1,2,3", None), Problem::Columns { found: 3 });
        assert_eq!(problem_of("", None), Problem::Columns { found: 1 });
        assert!(matches!(problem_of(&ROW.replace("0.5", "nan"), None), Problem::Number { field: "score", .. }));
        assert!(matches!(problem_of(&ROW.replace("20", "NaN"), None), Problem::Number { field: "t", .. }));
        assert!(matches!(problem_of(&ROW.replace("0.25", "inf"), None), Problem::Number { field: "time", .. }));
        assert!(matches!(problem_of(&ROW.replace("1,2,3", "1,-2,3"), None), Problem::Number { field: "im_id", .. }));
        assert!(matches!(problem_of(&ROW.replace("0 0 0 1,", "0 0 0 -1,"), None), Problem::Pose(_)));
        assert!(matches!(
            problem_of(&ROW.replace("0 0 0 1,", "0 0 1,"), None),
            Problem::Count { field: "R", found: 8, .. }
        ));
        assert!(matches!(
            problem_of(&ROW.replace("1,2,3", "1,9,3"), Some(&known)),
            Problem::UnknownImage { image_id: 9, .. }
        ));
        assert!(matches!(
            problem_of(&ROW.replace("1,2,3", "1,2,4"), Some(&known)),
            Problem::UnknownObject { object_id: 4 }
        ));
    }

    #[test]
    fn repeats_and_differing_times_name_the_first_line() {
        let twice = format!("{HEADER}\n{ROW}\n{ROW}\n");
        assert_eq!(parse_results(&twice, None).unwrap_err(), [(3, Problem::Duplicate { first_line: 2 })]);
        let other = ROW.replace("10 20", "11 20").replace("0.25", "0.5");
        let problems = parse_results(&format!("{HEADER}\n{ROW}\n{other}\n"), None).unwrap_err();
        assert_eq!(problems, [(3, Problem::Time { time: 0.5, first_time: 0.25, first_line: 2 })]);
        // Another instance of the same object is no repeat.
        let second = ROW.replace("10 20", "11 20");
        assert_eq!(parse_results(&format!("{ROW}\n{second}"), None).unwrap().len(), 2);
    }

    #[test]
    fn all_bad_lines_are_listed() {
        let text = format!("{HEADER}\n1,2\n{ROW}\nx\n");
        let lines: Vec<usize> = parse_results(&text, None).unwrap_err().into_iter().map(|p| p.0).collect();
        assert_eq!(lines, [2, 4]);
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a_b-test.csv");
        std::fs::write(&path, text).unwrap();
        let message = read_results(&path, None).unwrap_err().to_string();
        assert!(message.contains("line 2: 2 columns") && message.contains("line 4: 1 columns"), "{message}");
    }
}
