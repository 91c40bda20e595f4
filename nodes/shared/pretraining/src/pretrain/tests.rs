use super::*;
use crate::offline::Silent;
use pseudoflow_synthetic::write_sample_objects;
use std::fs;
use std::path::Path;

/// Two RAFT iterations on 64 px crops, from random weights.
fn tiny(folder: &Path) -> PretrainConfig {
    let network = folder.join("tiny.yaml");
    let yaml = "name: tiny\narch: small\nsize_px: 64\niterations_train: 2\niterations_infer: 2\n";
    fs::write(&network, yaml).unwrap();
    let mut config = PretrainConfig::new(
        vec![write_sample_objects(folder).unwrap()],
        &network.to_string_lossy(),
        folder.join("w.safetensors"),
    );
    (config.steps, config.batch, config.warm_start) = (4, 2, WarmStart::Random);
    config.device = ComputeDevice::Cpu;
    config.sizes = vec![SizeShare { size_px: 64, weight: 1.0 }, SizeShare { size_px: 72, weight: 1.0 }];
    config
}

/// Stops after some steps.
struct StopAt(u64, u64);

impl Progress for StopAt {
    fn start(&mut self, _: u64, _: u64) {}
    fn step(&mut self, step: u64, _: &str) {
        self.1 = step;
    }
    fn should_stop(&self) -> bool {
        self.1 >= self.0
    }
}

#[test]
fn an_interrupted_run_ends_with_the_bytes_of_an_unbroken_one() {
    let (one, two) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let whole = pretrain(&tiny(one.path()), &mut Silent).unwrap();
    assert!(whole.finished && whole.step == 4);
    let mut config = tiny(two.path());
    let part = pretrain(&config, &mut StopAt(2, 0)).unwrap();
    assert!(!part.finished && part.step == 2 && !config.out.exists());
    (config.resume, config.data_threads) = (true, 3);
    let rest = pretrain(&config, &mut Silent).unwrap();
    assert!(rest.finished);
    assert_eq!(fs::read(&whole.written).unwrap(), fs::read(&rest.written).unwrap());
    let log = |folder: &Path| fs::read_to_string(folder.join("w.csv")).unwrap();
    assert_eq!(log(one.path()), log(two.path()));
    assert!(fs::read_to_string(&rest.plot).unwrap().contains("polyline"));
}

#[test]
fn another_configuration_cannot_resume() {
    let folder = tempfile::tempdir().unwrap();
    let mut config = tiny(folder.path());
    pretrain(&config, &mut StopAt(1, 0)).unwrap();
    (config.resume, config.seed) = (true, 9);
    let message = pretrain(&config, &mut Silent).unwrap_err().to_string();
    assert!(message.contains("seed"), "{message}");
}

#[test]
fn errors_come_before_anything_is_written() {
    let folder = tempfile::tempdir().unwrap();
    let mut config = tiny(folder.path());
    config.out = folder.path().join("results/w.safetensors");
    config.warm_start = WarmStart::File(folder.path().join("none.safetensors"));
    assert!(pretrain(&config, &mut Silent).unwrap_err().to_string().contains("none.safetensors"));
    // Tests run in their crate's folder, where no weights lie, and carry none.
    config.warm_start = WarmStart::Auto;
    let message = pretrain(&config, &mut Silent).unwrap_err().to_string();
    assert!(message.contains("raft_small.safetensors: ") && message.contains("--warm-start"), "{message}");
    config.max_lr = -1.0;
    assert!(pretrain(&config, &mut Silent).unwrap_err().to_string().contains("max_lr"));
    assert!(!folder.path().join("results").exists());
}

#[test]
fn larger_crops_come_in_smaller_batches() {
    let folder = tempfile::tempdir().unwrap();
    let mut config = tiny(folder.path());
    config.network = "nano".to_owned();
    config.batch = 4;
    config.sizes = vec![SizeShare { size_px: 256, weight: 1.0 }];
    assert_eq!(data::plan(&config, 128, 3), (256, 1));
    config.sizes.clear();
    assert_eq!(data::plan(&config, 128, 3), (128, 4));
}

#[test]
fn every_pair_of_a_scene_is_used_once_and_a_batch_shows_different_scenes() {
    let folder = tempfile::tempdir().unwrap();
    let mut config = tiny(folder.path());
    (config.batch, config.synth.pairs_per_scene) = (5, 3);
    config.sizes = vec![SizeShare { size_px: 64, weight: 1.0 }, SizeShare { size_px: 128, weight: 1.0 }];
    let mut seen = std::collections::BTreeSet::new();
    for batch in data::uses(&config, 64, 48) {
        let scenes: std::collections::BTreeSet<_> = batch.iter().map(|(scene, _)| *scene).collect();
        assert_eq!(scenes.len(), batch.len(), "a batch repeats a scene");
        assert!(batch.iter().all(|use_of| seen.insert(*use_of)), "a pair is used twice");
    }
}

#[test]
fn the_refiner_trains_at_the_sizes_that_it_is_used_at() {
    let of = |network: &str| PretrainConfig::new(vec!["m".into()], network, "w.safetensors".into()).size_shares();
    let px = |shares: Vec<SizeShare>| shares.iter().map(|share| share.size_px).collect::<Vec<_>>();
    assert_eq!(px(of("refiner").unwrap()), [128, 256]);
    assert_eq!(px(of("nano").unwrap()), [128]);
    assert_eq!("256:2".parse(), Ok(SizeShare { size_px: 256, weight: 2.0 }));
    assert_eq!("192".parse(), Ok(SizeShare { size_px: 192, weight: 1.0 }));
    assert!("256:two".parse::<SizeShare>().unwrap_err().contains("256:two"));
}

#[test]
fn pairs_are_counted_at_each_size() {
    let mut config = tiny(tempfile::tempdir().unwrap().path());
    config.network = "nano".to_owned();
    config.sizes = vec![SizeShare { size_px: 128, weight: 1.0 }, SizeShare { size_px: 256, weight: 1.0 }];
    config.batch = 8;
    let schedule = data::Schedule::new(&config, 128).unwrap();
    let counted: u64 = (0..100).map(|step| data::plan(&config, 128, step).1 as u64).sum();
    assert_eq!(schedule.pairs_until(100), counted);
    assert!(counted > 200 && counted < 800, "{counted}");
}

#[test]
fn raft_learns_from_no_poses_and_says_so() {
    let folder = tempfile::tempdir().unwrap();
    let config = PretrainConfig { pose_weight: 20.0, ..tiny(folder.path()) };
    let message = pretrain(&config, &mut Silent).unwrap_err().to_string();
    assert!(message.contains("pose_weight") && message.contains("RAFT"), "{message}");
}
