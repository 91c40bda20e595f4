use super::*;

fn noise(len: usize, seed: u32) -> Vec<f32> {
    let next = |state: &mut u32| {
        *state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        Some((*state >> 8) as f32 / (1 << 23) as f32 - 1.0)
    };
    std::iter::repeat(()).scan(seed, |state, ()| next(state)).take(len).collect()
}

/// Threads change no bit, and how the images are grouped changes rounding only.
#[test]
fn groups_and_threads_change_nothing() {
    let (n, c, o, h, w) = (5, 18, 20, 9, 6);
    let [x, weights, bias, grad] = [n * c * h * w, o * c * 9, o, n * o * h * w].map(|len| noise(len, len as u32));
    let conv = WinogradConv { transformed: Arc::new(transform_weights(&weights)), relu: true };
    let shapes: [&[usize]; 3] = [&[n, c, h, w], &[o, c, 3, 3], &[o]];
    let inputs = [&x, &weights, &bias].map(|d| d.as_slice());
    let views: Vec<View<'_>> = shapes.iter().zip(inputs).map(|(shape, data)| View { shape, data }).collect();
    let run = |group: usize, threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let y = conv.forward_by(|_| group, &views);
            let output = View { shape: &y.shape, data: &y.data };
            let call = BackwardCall { inputs: &views, output, kept: &[], grad: &grad, wanted: &[true; 3] };
            let grads = conv.backward_by(|_| group, &call);
            (y.clone(), grads.into_iter().flatten().collect::<Vec<_>>())
        })
    };
    let (y, grads) = run(n, 1);
    assert_eq!(run(n, 3), (y.clone(), grads.clone()));
    assert_eq!(run(2, 1), run(2, 4));
    for group in [1, 2, 3] {
        let (other_y, other_grads) = run(group, 2);
        for (a, b) in std::iter::once((&other_y, &y)).chain(other_grads.iter().zip(&grads)) {
            for (a, b) in a.data.iter().zip(&b.data) {
                assert!((a - b).abs() < 1e-4 * (1.0 + b.abs()), "groups of {group}: {a} and {b}");
            }
        }
    }
}
