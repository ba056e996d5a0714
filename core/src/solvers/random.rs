//! Seeded random numbers in bulk: eight xoshiro256+ generators side by side, so that one vector instruction advances all of them. The number of lanes
//! is fixed, so the numbers never depend on the CPU.
//!
//! xoshiro256+ [Blackman, Vigna: Scrambled linear pseudorandom number generators, ACM TOMS 47(4), 2021, section 5] is made for floating-point
//! numbers: only its lowest bits are weak, and those are not used.

use multiversion::{multiversion, target::target_cfg_f};
use rand::rngs::ChaCha8Rng;
use rand::{Rng, SeedableRng};

/// Number of generators: one AVX-512 register of 64-bit words, two of AVX2.
pub const LANES: usize = 8;

/// A ChaCha8 generator for all random numbers outside of hot loops. `stream` separates the uses of one seed.
///
/// The key is built here instead of by `seed_from_u64`, whose expansion may change between releases.
pub fn chacha8(seed: u64, stream: u64) -> ChaCha8Rng {
    let mut key = [0_u8; 32];
    key[..8].copy_from_slice(&seed.to_le_bytes());
    key[8..16].copy_from_slice(&stream.to_le_bytes());
    ChaCha8Rng::from_seed(key)
}

/// The 53 upper bits as a number in [0, 1).
///
/// The upper 21 of these bits become the last bits of a number from 2³¹ on, whose unit in the last place is 2⁻²¹. The lower 32 become the last bits
/// of a number from 1/2 on, whose unit is 2⁻⁵³. Every operation is exact. All of them have vector instructions, even on CPUs without a vector
/// conversion of 64-bit integers.
#[inline(always)]
pub fn unit_interval(bits: u64) -> f64 {
    const TWO_POW_31: f64 = 2_147_483_648.0;
    let upper = f64::from_bits(TWO_POW_31.to_bits() | (bits >> 43));
    let lower = f64::from_bits(0.5f64.to_bits() | (bits >> 11 & 0xffff_ffff));
    (upper - (TWO_POW_31 + 0.5)) + lower
}

/// Eight independent xoshiro256+ generators.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LaneRandom {
    /// `state[word][lane]`.
    state: [[u64; LANES]; 4],
}

impl LaneRandom {
    /// The generator of a seed. `stream` separates the uses of one seed (first positions, updates, …).
    ///
    /// Each lane's 256 bits come from ChaCha8. The probability that streams overlap within any run is below 2⁻¹⁸⁰.
    pub fn new(seed: u64, stream: u64) -> Self {
        let mut source = chacha8(seed, stream);
        let mut state = [[0; LANES]; 4];
        for lane in 0..LANES {
            for word in &mut state {
                word[lane] = source.next_u64();
            }
        }
        Self { state }
    }

    /// Fills `numbers` with draws from [0, 1): number i is from lane i mod 8. An incomplete last block of eight uses up a whole block.
    pub fn fill(&mut self, numbers: &mut [f64]) {
        fill(&mut self.state, numbers);
    }
}

/// Left and right shift that form a rotation. They are hidden from the compiler: on CPUs without a vector rotation, it would process the eight lanes
/// one by one.
const ROTATION: (u32, u32) = (45, 64 - 45);

#[multiversion(targets("x86_64+avx512f+avx512dq+avx512vl", "x86_64+avx2+fma"))]
fn fill(state: &mut [[u64; LANES]; 4], numbers: &mut [f64]) {
    if target_cfg_f!(target_feature = "avx512dq") {
        fill_with(
            state,
            numbers,
            (bits_divided, |word| word.rotate_left(ROTATION.0)),
        );
    } else {
        let (left, right) = std::hint::black_box(ROTATION);
        fill_with(
            state,
            numbers,
            (unit_interval, |word| {
                word.wrapping_shl(left) | word.wrapping_shr(right)
            }),
        );
    }
}

/// As [`unit_interval`], with the same bits, for CPUs with vector conversion of 64-bit integers.
#[inline(always)]
fn bits_divided(bits: u64) -> f64 {
    const TWO_POW_53: f64 = 9_007_199_254_740_992.0;
    (bits >> 11) as f64 / TWO_POW_53
}

/// Fills `numbers`; `how` converts bits to a number and rotates a word.
#[inline(always)]
fn fill_with(
    state: &mut [[u64; LANES]; 4],
    numbers: &mut [f64],
    how: (impl Fn(u64) -> f64, impl Fn(u64) -> u64),
) {
    let mut blocks = numbers.chunks_exact_mut(LANES);
    for block in &mut blocks {
        block.copy_from_slice(&step(state, &how));
    }
    let rest = blocks.into_remainder();
    if !rest.is_empty() {
        let block = step(state, &how);
        rest.copy_from_slice(&block[..rest.len()]);
    }
}

/// One xoshiro256+ step in every lane.
#[inline(always)]
fn step(
    state: &mut [[u64; LANES]; 4],
    (number, rotated): &(impl Fn(u64) -> f64, impl Fn(u64) -> u64),
) -> [f64; LANES] {
    let [s0, s1, s2, s3] = state;
    let mut numbers = [0.0; LANES];
    for lane in 0..LANES {
        numbers[lane] = number(s0[lane].wrapping_add(s3[lane]));
        let shifted = s1[lane] << 17;
        s2[lane] ^= s0[lane];
        s3[lane] ^= s1[lane];
        s1[lane] ^= s2[lane];
        s0[lane] ^= s3[lane];
        s2[lane] ^= shifted;
        s3[lane] = rotated(s3[lane]);
    }
    numbers
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_unit_interval_is_the_upper_bits_divided() {
        let mut random = chacha8(1, 1);
        let edges = [
            0,
            1,
            1 << 11,
            1 << 42,
            1 << 43,
            (1 << 43) - 1,
            u64::MAX,
            u64::MAX << 43,
        ];
        for bits in edges
            .into_iter()
            .chain((0..10_000).map(|_| random.next_u64()))
        {
            assert_eq!(unit_interval(bits), bits_divided(bits), "{bits:x}");
        }
    }
}
