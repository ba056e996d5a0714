//! The vectorised generator, compared with a plain implementation and with the properties of uniform numbers.

use kincal::solvers::random::{LANES, LaneRandom};

/// One xoshiro256+ generator, as published by its authors.
struct Scalar([u64; 4]);

impl Scalar {
    fn next(&mut self) -> u64 {
        let s = &mut self.0;
        let result = s[0].wrapping_add(s[3]);
        let t = s[1] << 17;
        s[2] ^= s[0];
        s[3] ^= s[1];
        s[1] ^= s[2];
        s[0] ^= s[3];
        s[2] ^= t;
        s[3] = s[3].rotate_left(45);
        result
    }
}

/// `state[word][lane]` from any distinct numbers.
fn some_state() -> [[u64; LANES]; 4] {
    std::array::from_fn(|word| {
        std::array::from_fn(|lane| {
            0x9e37_79b9_7f4a_7c15_u64.wrapping_mul((word * LANES + lane + 1) as u64)
        })
    })
}

#[test]
fn the_first_outputs_from_state_1_2_3_4_are_the_published_ones() {
    // By hand from the recurrence: 1 + 4; then the state is (7, 0, 262146, 211106232532992).
    let mut scalar = Scalar([1, 2, 3, 4]);
    assert_eq!([scalar.next(), scalar.next()], [5, 211_106_232_532_999]);
    assert_eq!(scalar.0[0], 7 ^ 211_106_232_532_992);
}

#[test]
fn every_lane_is_a_xoshiro256_plus_of_its_own() {
    let state = some_state();
    let mut numbers = [0.0; LANES * 1000];
    LaneRandom::from_state(state).fill(&mut numbers);
    for lane in 0..LANES {
        let mut scalar = Scalar(std::array::from_fn(|word| state[word][lane]));
        for block in numbers.chunks_exact(LANES) {
            let expected = (scalar.next() >> 11) as f64 / (1_u64 << 53) as f64;
            assert_eq!(block[lane], expected);
        }
    }
}

#[test]
fn a_partial_block_uses_up_a_whole_block() {
    let mut whole = LaneRandom::new(7, 0);
    let mut partial = whole.clone();
    let mut numbers = [0.0; 16];
    whole.fill(&mut numbers);
    let mut three = [0.0; 3];
    partial.fill(&mut three);
    assert_eq!(three, numbers[..3]);
    partial.fill(&mut three);
    assert_eq!(three, numbers[8..11]);
}

#[test]
fn seeds_streams_and_lanes_give_different_numbers() {
    let draw = |seed, stream| {
        let mut numbers = [0.0; LANES];
        LaneRandom::new(seed, stream).fill(&mut numbers);
        numbers
    };
    let mut all: Vec<f64> = [draw(1, 0), draw(1, 1), draw(2, 0), draw(2, 1)].concat();
    all.sort_by(f64::total_cmp);
    all.dedup();
    assert_eq!(all.len(), 4 * LANES);
    assert_eq!(draw(1, 0), draw(1, 0));
}

#[test]
fn the_numbers_look_uniform() {
    const N: usize = 800_000;
    /// Five standard errors: one random run in two million would fail; the seed is fixed.
    const STANDARD_ERRORS: f64 = 5.0;
    let mut numbers = vec![0.0; N];
    LaneRandom::new(20_180, 3).fill(&mut numbers);
    assert!(numbers.iter().all(|u| (0.0..1.0).contains(u)));

    let n = N as f64;
    let mean = numbers.iter().sum::<f64>() / n;
    assert!(
        (mean - 0.5).abs() < STANDARD_ERRORS * (1.0 / 12.0 / n).sqrt(),
        "mean {mean}"
    );
    let variance = numbers.iter().map(|u| (u - 0.5).powi(2)).sum::<f64>() / n;
    assert!(
        (variance - 1.0 / 12.0).abs() < STANDARD_ERRORS * (1.0 / 180.0 / n).sqrt(),
        "variance {variance}"
    );

    const BINS: usize = 256;
    let mut counts = [0.0; BINS];
    for u in &numbers {
        counts[(u * BINS as f64) as usize] += 1.0;
    }
    let expected = n / BINS as f64;
    let chi_squared: f64 = counts
        .iter()
        .map(|count: &f64| (count - expected).powi(2) / expected)
        .sum();
    let degrees = (BINS - 1) as f64;
    assert!(
        (chi_squared - degrees).abs() < STANDARD_ERRORS * (2.0 * degrees).sqrt(),
        "chi squared {chi_squared}"
    );
}

#[test]
fn neighbouring_lanes_and_successive_draws_are_uncorrelated() {
    const N: usize = 400_000;
    const STANDARD_ERRORS: f64 = 5.0;
    let mut numbers = vec![0.0; N];
    LaneRandom::new(5, 0).fill(&mut numbers);
    for lag in [1, LANES - 1, LANES, 2 * LANES] {
        let sum: f64 = numbers
            .iter()
            .zip(&numbers[lag..])
            .map(|(a, b)| (a - 0.5) * (b - 0.5))
            .sum();
        let correlation = 12.0 * sum / (N - lag) as f64;
        assert!(
            correlation.abs() < STANDARD_ERRORS / (N as f64).sqrt(),
            "lag {lag}: {correlation}"
        );
    }
}
