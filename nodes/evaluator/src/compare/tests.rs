use super::*;
use crate::{Scores, VsdDepth};

fn report(correct: &[bool]) -> Report {
    let instance = |(i, correct): (usize, &bool)| InstanceErrors {
        image_id: i as u32,
        object_id: 1 + i as u32 % 2,
        add_s_correct: *correct,
        add_s_m: Some(if *correct { 0.0 } else { 1.0 }),
        ..InstanceErrors::default()
    };
    let instances: Vec<InstanceErrors> = correct.iter().enumerate().map(instance).collect();
    let scores = Scores::of(&instances.iter().collect::<Vec<_>>(), None);
    Report {
        dataset: "set".into(),
        split: "test".into(),
        vsd_depth: VsdDepth::Rendered,
        notes: vec![],
        sets: vec!["refined".into()],
        overall: [("refined".into(), scores)].into(),
        per_object: BTreeMap::new(),
        objects: BTreeMap::new(),
        instances: [("refined".into(), instances)].into(),
        diagnosis: BTreeMap::new(),
        object_diagnosis: BTreeMap::new(),
        without: None,
    }
}

#[test]
fn an_old_report_without_a_diagnosis_can_be_read_and_compared() {
    let mut old = serde_json::to_value(report(&[true, false])).unwrap();
    ["diagnosis", "object_diagnosis", "without"].iter().for_each(|key| _ = old.as_object_mut().unwrap().remove(*key));
    for instance in old["instances"]["refined"].as_array_mut().unwrap() {
        let fields = ["depth_of_diameter", "add_s_true_depth_of_diameter", "confidence", "mahalanobis2", "gate"];
        fields.iter().for_each(|key| assert!(instance.as_object_mut().unwrap().remove(*key).is_some(), "{key}"));
    }
    let old: Report = serde_json::from_value(old).unwrap();
    assert_eq!(compare(&old, &report(&[true, true])).unwrap().overall["add_s_recall_0.1d"].difference, 0.5);
}

#[test]
fn a_report_against_itself_differs_by_nothing() {
    let a = report(&[true, false, true, true]);
    let comparison = compare(&a, &a).unwrap();
    for d in comparison.overall.values().chain(comparison.per_object.values().flat_map(BTreeMap::values)) {
        assert_eq!((d.difference, d.low, d.high), (0.0, 0.0, 0.0));
    }
    assert_eq!(comparison.per_object.keys().copied().collect::<Vec<_>>(), [1, 2]);
}

#[test]
fn the_interval_is_that_of_the_binomial() {
    // 400 instances, of which B gains 100: the difference is 0.25 with a standard error of sqrt(.25 * .75 / 400).
    let a = report(&[false; 400]);
    let b = report(&(0..400).map(|i| i % 4 == 0).collect::<Vec<_>>());
    let d = compare(&a, &b).unwrap().overall["add_s_recall_0.1d"];
    let error = (0.25_f64 * 0.75 / 400.0).sqrt();
    assert!((d.difference - 0.25).abs() < 1e-12 && (d.a, d.b) == (0.0, 0.25));
    assert!((d.low - (0.25 - 1.96 * error)).abs() < 0.2 * error, "{d:?}");
    assert!((d.high - (0.25 + 1.96 * error)).abs() < 0.2 * error, "{d:?}");
}

#[test]
fn only_common_instances_count() {
    let comparison = compare(&report(&[true; 6]), &report(&[true; 4])).unwrap();
    assert_eq!((comparison.overall["ar"].n, comparison.unpaired), (4, 2));
    let none = compare(&report(&[true; 6]), &report(&[]));
    assert!(matches!(none, Err(EvalError::NothingInCommon { .. })));
    let wrong = compare_sets(&report(&[true]), "init", &report(&[true]), "refined");
    assert!(wrong.unwrap_err().to_string().contains("not `init`"));
}

#[test]
fn the_same_reports_give_the_same_page() {
    let (a, b) = (report(&[true, false, false]), report(&[true, true, false]));
    let dir = tempfile::tempdir().unwrap();
    let write = |name: &str| {
        let path = dir.path().join(name);
        compare(&a, &b).unwrap().write_html(&path).unwrap();
        std::fs::read(path).unwrap()
    };
    assert_eq!(write("1.html"), write("2.html"));
}
