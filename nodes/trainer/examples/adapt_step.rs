//! Time of a self-supervised step beside supervised ones of as many pairs:
//! `cargo run --release --example adapt_step -- [network] [size_px] [instances] [views] [partners] [rounds]`,
//! by default nano, 128, 4, 4, 3, 15. The kinds take turns, so that other load on the machine meets all alike.
#![allow(clippy::print_stdout, reason = "a bench prints its numbers")]

use pseudoflow_learning::{Device, ExtraLoss, FlowBatch, TrainConfig, TrainState};
use pseudoflow_msgs::{
    AlignedBytes, FlowFields, FlowFieldsHeader, Message, Partner, PseudoLabels, PseudoLabelsHeader, ReferenceViews,
    ReferenceViewsHeader,
};
use pseudoflow_network::{FlowNetwork, Weights};
use pseudoflow_trainer::{AdaptState, Sample, SampleForm, TrainerConfig};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::time::Instant;

type Failure = Box<dyn std::error::Error>;

/// What is measured.
struct Sizes {
    network: String,
    size_px: usize,
    instances: usize,
    views: usize,
    partners: usize,
    rounds: usize,
}

impl Sizes {
    fn from_args() -> Result<Self, Failure> {
        let args: Vec<String> = std::env::args().skip(1).collect();
        let number = |i: usize, default: usize| args.get(i).map_or(Ok(default), |v| v.parse());
        let network = args.first().map_or("nano", String::as_str).to_owned();
        let (size_px, instances, views) = (number(1, 128)?, number(2, 4)?, number(3, 4)?);
        Ok(Self { network, size_px, instances, views, partners: number(4, 3)?, rounds: number(5, 15)? })
    }
}

/// Messages of one frame with noise for images, flows of up to 3 px, and an object on half of the crop.
fn messages(sizes: &Sizes) -> [AlignedBytes; 3] {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let (side, area) = (sizes.size_px as u32, sizes.size_px * sizes.size_px);
    let on_object = |p: usize| {
        let offset = |v: usize| (2 * v) as f64 / f64::from(side) - 1.0;
        offset(p % sizes.size_px).hypot(offset(p / sizes.size_px)) < 0.8
    };
    let header = ReferenceViewsHeader {
        instances: sizes.instances as u32,
        views_per_instance: sizes.views as u32,
        size_px: side,
        scene_id: 0,
        image_id: 0,
        skipped: 0,
        partners_per_instance: sizes.partners as u32,
        reserved: 0,
    };
    let mut views = AlignedBytes::zeroed(ReferenceViews::byte_len(&header));
    let message = ReferenceViews::write(&mut views, header);
    [message.rgb, message.real_rgb, message.partner_rgb].into_iter().flatten().for_each(|v| *v = rng.random());
    message.partners.fill(Partner { scene_id: 0, image_id: 1, present: 1, reserved: 0 });
    message.mask.iter_mut().enumerate().for_each(|(p, v)| *v = 255 * u8::from(on_object(p % area)));

    let fields = (sizes.instances * (sizes.views + sizes.partners)) as u32;
    let header = FlowFieldsHeader { fields, size_px: side, weights_version: 0, has_certainty: 0, reserved: 0 };
    let mut flow = AlignedBytes::zeroed(FlowFields::byte_len(&header));
    FlowFields::write(&mut flow, header).flow_px.iter_mut().for_each(|v| *v = rng.random_range(-3.0..3.0));

    let header = PseudoLabelsHeader {
        weights_version: 0,
        instances: sizes.instances as u32,
        views_per_instance: sizes.views as u32,
        size_px: side,
        scene_id: 0,
        image_id: 0,
        tau_px: 1.0,
    };
    let mut labels = AlignedBytes::zeroed(PseudoLabels::byte_len(&header));
    let message = PseudoLabels::write(&mut labels, header);
    message.valid.iter_mut().enumerate().for_each(|(p, v)| *v = 255 * u8::from(on_object(p % area)));
    message.label_px.iter_mut().for_each(|v| *v = rng.random_range(-3.0..3.0));
    [views, flow, labels]
}

fn samples(sizes: &Sizes, [views, flow, labels]: &[AlignedBytes; 3]) -> Result<Vec<Sample>, Failure> {
    let (views, flow, labels) = (ReferenceViews::view(views)?, FlowFields::view(flow)?, PseudoLabels::view(labels)?);
    let form = SampleForm { by: 1, geometry: FlowNetwork::named(&sizes.network)?.is_refiner() };
    let of = |i: usize| Sample::of(&views, &flow, &labels, i, form, Some(ChaCha8Rng::seed_from_u64(i as u64)));
    Ok((0..sizes.instances).map(of).collect())
}

/// Times of one kind of step.
struct Times(&'static str, Vec<f64>);

impl Times {
    fn add<T>(&mut self, work: impl FnOnce() -> T) -> T {
        let start = Instant::now();
        let result = work();
        self.1.push(start.elapsed().as_secs_f64() * 1e3);
        result
    }

    /// Median and least, without the first: it warms up.
    fn summary(&self) -> [f64; 2] {
        let mut times = self.1[1..].to_vec();
        times.sort_by(f64::total_cmp);
        [times[times.len() / 2], times[0]]
    }
}

/// No loss beside that of the flow.
fn no_extra(flow_px: &[f32]) -> ExtraLoss {
    ExtraLoss { value: 0.0, gradient: vec![0.0; flow_px.len()] }
}

fn main() -> Result<(), Failure> {
    let sizes = Sizes::from_args()?;
    let folder = std::env::temp_dir().join(format!("adapt_step_{}", std::process::id()));
    std::fs::create_dir_all(&folder)?;
    let start = folder.join("start.safetensors");
    let mut config = TrainerConfig::new(start.clone(), folder.clone(), 10_000);
    (config.network, config.size_px, config.max_lr) = (sizes.network.clone(), sizes.size_px as u32, 1e-6);
    let network = config.resolve_network()?;
    Weights::random(&network, 1).save(&start)?;
    let without_photo = TrainerConfig { photo_weight: 0.0, ..config.clone() };

    let messages = messages(&sizes);
    let mut batch = samples(&sizes, &messages)?;
    let n = sizes.instances * sizes.views;
    let all = |part: fn(&Sample) -> &[f32]| batch.iter().flat_map(part).copied().collect::<Vec<f32>>();
    let (reference, flow, mask) = (all(|s| &s.reference), all(|s| &s.flow_px), all(|s| &s.mask));
    let pairs = FlowBatch { reference: &reference, real: &reference, flow: &flow, mask: &mask, n };

    let mut supervised = TrainState::new(
        network.clone(),
        TrainConfig::new(1e-6, 10_000),
        Weights::load(&start, &network)?,
        &Device::flex(),
    )?;
    let (mut own, mut plain) = (AdaptState::new(&config)?, AdaptState::new(&config)?);
    std::fs::remove_dir_all(&folder)?;
    let names = ["supervised", "self-supervised", "the same without photo", "samples from messages"];
    let [mut a, mut b, mut c, mut d] = names.map(|name| Times(name, Vec::new()));
    for _ in 0..=sizes.rounds {
        a.add(|| supervised.train_step_with(&pairs, sizes.size_px, 1.0, no_extra))?;
        b.add(|| own.train(&mut batch, &config))?;
        c.add(|| plain.train(&mut batch, &without_photo))?;
        d.add(|| samples(&sizes, &messages))?;
    }
    let Sizes { network, size_px, instances, views, partners, rounds } = &sizes;
    println!("{network} {size_px} px, {instances} instances x {views} views, {partners} partners, {rounds} rounds");
    let base = a.summary();
    for times in [&a, &b, &c, &d] {
        let [median, least] = times.summary();
        let ratio = [median / base[0], least / base[1]];
        println!(
            "{:24} median {median:8.1} ms, least {least:8.1} ms; of supervised {:.3}, {:.3}",
            times.0, ratio[0], ratio[1]
        );
    }
    Ok(())
}
