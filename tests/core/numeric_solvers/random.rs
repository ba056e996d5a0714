//! The vectorised generator, compared with a plain implementation.

use kincal::solvers::random::{LANES, LaneRandom, chacha8};
use rand::Rng;

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

#[test]
fn the_first_outputs_from_state_1_2_3_4_are_the_published_ones() {
    // By hand from the recurrence: 1 + 4; then the state is (7, 0, 262146, 211106232532992).
    let mut scalar = Scalar([1, 2, 3, 4]);
    assert_eq!([scalar.next(), scalar.next()], [5, 211_106_232_532_999]);
    assert_eq!(scalar.0[0], 7 ^ 211_106_232_532_992);
}

#[test]
fn every_lane_is_a_xoshiro256_plus_of_its_own() {
    let mut numbers = [0.0; LANES * 1000];
    LaneRandom::new(7, 3).fill(&mut numbers);
    let mut states = chacha8(7, 3);
    for lane in 0..LANES {
        let mut scalar = Scalar(std::array::from_fn(|_| states.next_u64()));
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
