//! Each kernel against the stock operations (values and gradients) and against finite differences.

use super::*;
use burn::tensor::{Gradients, TensorData};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

fn device() -> Device {
    Device::flex().autodiff()
}

/// Uniform values in [-1, 1], tracked.
fn random<const D: usize>(shape: [usize; D], seed: u64) -> Tensor<D> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let values: Vec<f32> = (0..shape.iter().product::<usize>()).map(|_| rng.random_range(-1.0..1.0)).collect();
    from_values(values, shape)
}

fn from_values<const D: usize>(values: Vec<f32>, shape: [usize; D]) -> Tensor<D> {
    Tensor::from_data(TensorData::new(values, shape), &device()).require_grad()
}

fn values<const D: usize>(t: Tensor<D>) -> Vec<f32> {
    t.into_data().try_into_vec().unwrap()
}

fn assert_close(what: &str, a: &[f32], b: &[f32], tolerance: f32) {
    assert_eq!(a.len(), b.len(), "{what}: lengths");
    for (i, (a, b)) in a.iter().zip(b).enumerate() {
        assert!((a - b).abs() <= tolerance * (1.0 + b.abs()), "{what}[{i}]: {a} against {b}");
    }
}

/// A loss that weighs every output differently.
fn weigh<const D: usize>(y: Tensor<D>) -> Tensor<1> {
    let weights = values(random(y.dims(), 99));
    let weights = Tensor::<D>::from_data(TensorData::new(weights, y.dims()), &device());
    (y * weights).sum()
}

fn grad_of<const D: usize>(t: &Tensor<D>, grads: &Gradients) -> Vec<f32> {
    values(t.grad(grads).expect("tracked"))
}

/// Compares a gradient with central differences of `f` at up to 40 places, by f32 forward passes summed in f64.
fn check_differences<const D: usize>(what: &str, x: &Tensor<D>, grad: &[f32], f: impl Fn(Tensor<D>) -> f64) {
    let base = values(x.clone());
    let step = 1e-2_f32;
    for i in (0..base.len()).step_by(base.len().div_ceil(40)) {
        let at = |delta: f32| {
            let mut moved = base.clone();
            moved[i] += delta;
            f(from_values(moved, x.dims()))
        };
        let numeric = (at(step) - at(-step)) / f64::from(2.0 * step);
        let analytic = f64::from(grad[i]);
        assert!((numeric - analytic).abs() < 2e-2 * (1.0 + analytic.abs()), "{what}[{i}]: {numeric} and {analytic}");
    }
}

fn weighed<const D: usize>(y: Tensor<D>) -> f64 {
    let weights = values(random(y.dims(), 99));
    values(y).iter().zip(weights).map(|(y, w)| f64::from(*y) * f64::from(w)).sum()
}

type Convolution = fn(Tensor<4>, Tensor<4>, Tensor<1>, ConvSpec) -> Tensor<4>;

/// Shapes of x and w, stride and padding.
type Case = ([usize; 4], [usize; 4], usize, [usize; 2]);

/// Compares a convolution with burn's own, with and without ReLU.
fn assert_equals_stock(convolution: Convolution, cases: &[Case]) {
    for (i, (xs, ws, stride, pad)) in cases.iter().copied().enumerate() {
        for relu in [false, true] {
            let (x, w, b) = (random(xs, 1), random(ws, 2), random([ws[0]], 3));
            let spec = ConvSpec { stride, pad, relu };
            let ours = convolution(x.clone(), w.clone(), b.clone(), spec);
            let theirs = stock::conv2d(x.clone(), w.clone(), b.clone(), spec);
            assert_close(&format!("conv {i}"), &values(ours.clone()), &values(theirs.clone()), 1e-4);
            let (ours, theirs) = (weigh(ours).backward(), weigh(theirs).backward());
            assert_close(&format!("dx {i}"), &grad_of(&x, &ours), &grad_of(&x, &theirs), 1e-4);
            assert_close(&format!("dw {i}"), &grad_of(&w, &ours), &grad_of(&w, &theirs), 2e-4);
            assert_close(&format!("db {i}"), &grad_of(&b, &ours), &grad_of(&b, &theirs), 1e-4);
        }
    }
}

#[test]
fn convolutions_equal_stock() {
    let cases = [
        ([2, 3, 11, 9], [5, 3, 7, 7], 2, [3, 3]),
        ([2, 8, 10, 12], [4, 8, 1, 1], 1, [0, 0]),
        ([3, 6, 9, 8], [4, 6, 1, 1], 2, [0, 0]),
        ([2, 4, 9, 10], [6, 4, 3, 3], 2, [1, 1]),
        ([1, 4, 6, 7], [3, 4, 1, 5], 1, [0, 2]),
        ([1, 4, 6, 7], [3, 4, 5, 1], 1, [2, 0]),
        ([2, 70, 40, 40], [3, 70, 3, 3], 1, [1, 1]),
    ];
    assert_equals_stock(conv2d, &cases);
    // GPUs take slices and a product.
    assert_equals_stock(columns::conv2d, &cases);
}

#[test]
fn convolution_gradients_equal_differences() {
    let (x, w, b) = (random([2, 3, 7, 6], 1), random([4, 3, 3, 3], 2), random([4], 3));
    let spec = ConvSpec { stride: 2, pad: [1, 1], relu: false };
    let f = |x: Tensor<4>, w: Tensor<4>, b: Tensor<1>| conv2d(x, w, b, spec);
    let grads = weigh(f(x.clone(), w.clone(), b.clone())).backward();
    check_differences("x", &x, &grad_of(&x, &grads), |x| weighed(f(x, w.clone(), b.clone())));
    check_differences("w", &w, &grad_of(&w, &grads), |w| weighed(f(x.clone(), w, b.clone())));
    check_differences("b", &b, &grad_of(&b, &grads), |b| weighed(f(x.clone(), w.clone(), b)));
}

#[test]
fn winograd_equals_stock_and_differences() {
    let sizes = [(3, 5, 4, 8, 8), (3, 5, 4, 7, 5), (3, 5, 4, 1, 1), (3, 5, 4, 16, 16)];
    // More channels than a vector holds, and whole vectors.
    let wide = [(2, 17, 33, 5, 9), (1, 32, 16, 3, 6), (3, 6, 20, 19, 22)];
    for (n, c, o, h, w) in sizes.into_iter().chain(wide) {
        for relu in [false, true] {
            let (x, g, b) = (random([n, c, h, w], 1), random([o, c, 3, 3], 2), random([o], 3));
            let ours = conv3x3(x.clone(), &Prepared3x3::new(g.clone(), b.clone()), relu);
            let spec = ConvSpec { stride: 1, pad: [1, 1], relu };
            let theirs = stock::conv2d(x.clone(), g.clone(), b.clone(), spec);
            // F(4x4, 3x3) rounds a little more than a plain sum.
            assert_close("y", &values(ours.clone()), &values(theirs.clone()), 5e-5);
            let (ours, theirs) = (weigh(ours).backward(), weigh(theirs).backward());
            assert_close("dx", &grad_of(&x, &ours), &grad_of(&x, &theirs), 1e-4);
            assert_close("dw", &grad_of(&g, &ours), &grad_of(&g, &theirs), 1e-4);
            assert_close("db", &grad_of(&b, &ours), &grad_of(&b, &theirs), 1e-4);
        }
    }
    let (x, g, b) = (random([2, 3, 6, 5], 4), random([2, 3, 3, 3], 5), random([2], 6));
    let f = |x: Tensor<4>, g: Tensor<4>| conv3x3(x, &Prepared3x3::new(g, b.clone()), false);
    let grads = weigh(f(x.clone(), g.clone())).backward();
    check_differences("x", &x, &grad_of(&x, &grads), |x| weighed(f(x, g.clone())));
    check_differences("g", &g, &grad_of(&g, &grads), |g| weighed(f(x.clone(), g)));
}

#[test]
fn instance_norm_equals_stock_and_differences() {
    for relu in [false, true] {
        let x = random([2, 3, 7, 9], 1);
        let (ours, theirs) = (instance_norm(x.clone(), relu), stock::instance_norm(x.clone(), relu));
        assert_close("y", &values(ours.clone()), &values(theirs.clone()), 1e-5);
        let (ours, theirs) = (weigh(ours).backward(), weigh(theirs).backward());
        assert_close("dx", &grad_of(&x, &ours), &grad_of(&x, &theirs), 1e-4);
    }
    let x = random([1, 2, 5, 4], 2);
    let grads = weigh(instance_norm(x.clone(), false)).backward();
    check_differences("x", &x, &grad_of(&x, &grads), |x| weighed(instance_norm(x, false)));
}

#[test]
fn add_relu_equals_stock() {
    let (a, b) = (random([2, 3, 5, 4], 1), random([2, 3, 5, 4], 2));
    let ours = add_relu(a.clone(), b.clone());
    let theirs = burn::tensor::activation::relu(a.clone() + b.clone());
    assert_close("y", &values(ours.clone()), &values(theirs.clone()), 0.0);
    let (ours, theirs) = (weigh(ours).backward(), weigh(theirs).backward());
    assert_close("da", &grad_of(&a, &ours), &grad_of(&a, &theirs), 0.0);
    assert_close("db", &grad_of(&b, &ours), &grad_of(&b, &theirs), 0.0);
}

#[test]
fn lookup_equals_stock_and_differences() {
    let levels = [[8, 6], [4, 3], [2, 1]];
    let q = levels.iter().map(|[h, w]| h * w).sum();
    // Positions inside, across every border, far outside, and whole.
    let mut coords = values(random([2, 2, 8, 6], 5));
    coords.iter_mut().for_each(|v| *v = 4.0 + 9.0 * *v);
    coords[..4].copy_from_slice(&[0.0, 3.0, -500.0, 1e9]);
    let coords = from_values(coords, [2, 2, 8, 6]).detach();
    let pyramid = random([2, 48, q], 6);
    for radius in [1, 3] {
        let ours = lookup(pyramid.clone(), coords.clone(), radius, &levels);
        let theirs = stock::lookup(pyramid.clone(), coords.clone(), radius, &levels);
        assert_close("y", &values(ours.clone()), &values(theirs.clone()), 1e-4);
        let (ours, theirs) = (weigh(ours).backward(), weigh(theirs).backward());
        assert_close("dpyramid", &grad_of(&pyramid, &ours), &grad_of(&pyramid, &theirs), 1e-4);
    }
    let f = |pyramid: Tensor<3>| lookup(pyramid, coords.clone(), 2, &levels);
    let grads = weigh(f(pyramid.clone())).backward();
    check_differences("pyramid", &pyramid, &grad_of(&pyramid, &grads), |p| weighed(f(p)));
}

/// At whole coordinates the window's centre is the texel itself: the convention of pixel centres.
#[test]
fn lookup_reads_whole_texels_exactly() {
    let pyramid = random([1, 20, 20], 3);
    let grid: Vec<f32> = (0..20).map(|i| (i % 5) as f32).chain((0..20).map(|i| (i / 5) as f32)).collect();
    let y = values(lookup(pyramid.clone(), from_values(grid, [1, 2, 4, 5]), 1, &[[4, 5]]));
    let volume = values(pyramid);
    for p in 0..20 {
        assert_eq!(y[4 * 20 + p], volume[p * 20 + p]);
    }
}

#[test]
fn gru_parts_equal_stock_and_differences() {
    let (a, c) = (random([2, 6, 3, 4], 1), random([2, 6, 3, 4], 2));
    let (aq, cq, h) = (random([2, 3, 3, 4], 3), random([2, 3, 3, 4], 4), random([2, 3, 3, 4], 5));
    let ours = reset_gate(a.clone(), c.clone(), h.clone());
    let theirs = stock::reset_gate(a.clone(), c.clone(), h.clone());
    assert_close("reset", &values(ours.clone()), &values(theirs.clone()), 1e-6);
    let (ours, theirs) = (weigh(ours).backward(), weigh(theirs).backward());
    for t in [&a, &c, &h] {
        assert_close("reset gradient", &grad_of(t, &ours), &grad_of(t, &theirs), 1e-5);
    }
    let all = [&a, &c, &aq, &cq, &h];
    let blend = |[a, c, aq, cq, h]: [Tensor<4>; 5]| gru_blend([a, c], [aq, cq], h);
    let ours = blend(all.map(Clone::clone));
    let theirs = stock::gru_blend([a.clone(), c.clone()], [aq.clone(), cq.clone()], h.clone());
    assert_close("blend", &values(ours.clone()), &values(theirs.clone()), 1e-6);
    let (ours, theirs) = (weigh(ours).backward(), weigh(theirs).backward());
    for (i, t) in all.into_iter().enumerate() {
        assert_close("blend gradient", &grad_of(t, &ours), &grad_of(t, &theirs), 1e-5);
        check_differences("blend", t, &grad_of(t, &ours), |moved| {
            let mut inputs = all.map(Clone::clone);
            inputs[i] = moved;
            weighed(blend(inputs))
        });
    }
}

#[test]
fn upsampling_equals_stock_and_differences() {
    let flow = random([2, 2, 4, 3], 1);
    let (ours, theirs) = (upsample_bilinear(flow.clone()), stock::upsample_bilinear(flow.clone()));
    assert_close("y", &values(ours.clone()), &values(theirs.clone()), 1e-5);
    let grads = weigh(ours).backward();
    assert_close("dx", &grad_of(&flow, &grads), &grad_of(&flow, &weigh(theirs).backward()), 1e-4);
    check_differences("flow", &flow, &grad_of(&flow, &grads), |f| weighed(upsample_bilinear(f)));
    // Corners are kept, times 8.
    let (coarse, fine) = (values(flow.clone()), values(upsample_bilinear(flow)));
    assert_close("corner", &[fine[0], fine[32 * 24 - 1]], &[8.0 * coarse[0], 8.0 * coarse[11]], 1e-6);
}

#[test]
fn masked_l1_equals_stock_and_differences() {
    let (flow, target) = (random([2, 2, 5, 4], 1), random([2, 2, 5, 4], 2));
    let mask: Vec<f32> = (0..40).map(|i| f32::from(u8::from(i % 3 != 0))).collect();
    let mask = from_values(mask, [2, 1, 5, 4]).detach();
    let f = |flow: Tensor<4>| masked_l1(flow, target.clone(), mask.clone());
    let theirs = stock::masked_l1(flow.clone(), target.clone(), mask.clone());
    assert_close("loss", &values(f(flow.clone())), &values(theirs.clone()), 1e-6);
    let grads = f(flow.clone()).backward();
    assert_close("gradient", &grad_of(&flow, &grads), &grad_of(&flow, &theirs.backward()), 1e-6);
    check_differences("flow", &flow, &grad_of(&flow, &grads), |x| f64::from(values(f(x))[0]));
}

#[test]
fn nan_is_not_hidden() {
    let x = from_values(vec![f32::NAN; 16], [1, 1, 4, 4]);
    let (w, b) = (random([1, 1, 3, 3], 1), random([1], 2));
    let spec = ConvSpec { stride: 1, pad: [1, 1], relu: true };
    assert!(values(conv2d(x.clone(), w.clone(), b.clone(), spec)).iter().all(|v| v.is_nan()));
    assert!(values(conv3x3(x.clone(), &Prepared3x3::new(w, b), true)).iter().all(|v| v.is_nan()));
    assert!(values(instance_norm(x.clone(), true)).iter().all(|v| v.is_nan()));
    assert!(values(add_relu(x.clone(), x)).iter().all(|v| v.is_nan()));
}

#[test]
fn gated_update_equals_stock_and_differences() {
    let (a, c, h) = (random([2, 6, 4, 5], 1), random([2, 6, 4, 5], 2), random([2, 3, 4, 5], 3));
    let ours = gated_update(a.clone(), c.clone(), h.clone());
    let theirs = stock::gated_update(a.clone(), c.clone(), h.clone());
    assert_close("y", &values(ours.clone()), &values(theirs.clone()), 1e-5);
    let (ours, theirs) = (weigh(ours).backward(), weigh(theirs).backward());
    for (name, t) in [("a", &a), ("c", &c), ("h", &h)] {
        assert_close(name, &grad_of(t, &ours), &grad_of(t, &theirs), 1e-5);
    }
    check_differences("a", &a, &grad_of(&a, &ours), |a| weighed(gated_update(a, c.clone(), h.clone())));
}

#[test]
fn convex_upsampling_equals_stock_and_differences() {
    for (h, w) in [(3, 4), (1, 2), (2, 1)] {
        let (x, logits) = (random([2, 3, h, w], 1), random([2, 576, h, w], 2));
        let ours = upsample_convex(x.clone(), logits.clone());
        let theirs = stock::upsample_convex(x.clone(), logits.clone());
        assert_eq!(ours.dims(), [2, 3, 8 * h, 8 * w]);
        assert_close("y", &values(ours.clone()), &values(theirs.clone()), 1e-5);
        let (ours, theirs) = (weigh(ours).backward(), weigh(theirs).backward());
        assert_close("x", &grad_of(&x, &ours), &grad_of(&x, &theirs), 1e-4);
        assert_close("logits", &grad_of(&logits, &ours), &grad_of(&logits, &theirs), 1e-4);
        check_differences("logits", &logits, &grad_of(&logits, &ours), |l| weighed(upsample_convex(x.clone(), l)));
    }
}

/// Errors well away from zero, where an L1 distance has a corner; hidden, counted and background pixels.
#[test]
fn mixture_loss_equals_stock_and_differences() {
    let prediction = random([2, 5, 4, 6], 1);
    let area = 24;
    let mut target = vec![0.0; 2 * 4 * area];
    for image in target.chunks_exact_mut(4 * area) {
        for i in 0..area {
            (image[i], image[area + i]) = (if i % 2 == 0 { 1.5 } else { -4.0 }, 2.5);
            image[2 * area + i] = f32::from(u8::from(i % 3 == 0));
            image[3 * area + i] = [1.0, 0.0, -1.0][i % 3];
        }
    }
    let target = Tensor::<4>::from_data(TensorData::new(target, [2, 4, 4, 6]), &device());
    let ours = mixture_loss(prediction.clone(), target.clone(), 0.7);
    let theirs = stock::mixture_loss(prediction.clone(), target.clone(), 0.7);
    assert_close("loss", &values(ours.clone()), &values(theirs.clone()), 1e-5);
    let (ours, theirs) = (ours.backward(), theirs.backward());
    assert_close("gradient", &grad_of(&prediction, &ours), &grad_of(&prediction, &theirs), 1e-4);
    let loss = |p| f64::from(values(mixture_loss(p, target.clone(), 0.7))[0]);
    check_differences("prediction", &prediction, &grad_of(&prediction, &ours), loss);
}
