//! Eight values side by side, arithmetic on as many of them as a register holds, and detection of the CPU's registers.

use std::ops::{Add, Mul, Neg, Sub};

/// Particles per chunk. The number is fixed, so that results do not depend on the machine's vector width.
pub const LANES: usize = 8;

/// One value for each of the eight particles, in one cache line.
#[derive(Clone, Copy, Debug, PartialEq)]
#[repr(C, align(64))]
pub struct Lanes(pub [f64; LANES]);

impl Lanes {
    /// All zero.
    pub const ZERO: Self = Self([0.0; LANES]);

    /// The same value for every particle.
    pub const fn splat(value: f64) -> Self {
        Self([value; LANES])
    }
}

/// The code paths of the kernel: one source, compiled for each.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum InstructionSet {
    /// Instructions that every CPU of the target has: NEON on ARM. On x86-64 a fused multiply-add is then a function call.
    Baseline,
    /// Four lanes, 16 registers.
    Avx2,
    /// Eight lanes, 32 registers.
    Avx512,
}

impl InstructionSet {
    /// All instruction sets of this CPU, the fastest first.
    pub fn all_here() -> Vec<Self> {
        [Self::Avx512, Self::Avx2, Self::Baseline]
            .into_iter()
            .filter(|set| set.is_here())
            .collect()
    }

    /// The fastest instruction set of this CPU.
    pub fn fastest() -> Self {
        Self::all_here()[0]
    }

    #[cfg(target_arch = "x86_64")]
    fn is_here(self) -> bool {
        match self {
            Self::Baseline => true,
            Self::Avx2 => is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma"),
            Self::Avx512 => has_fast_avx512(),
        }
    }

    #[cfg(not(target_arch = "x86_64"))]
    fn is_here(self) -> bool {
        self == Self::Baseline
    }
}

/// AVX-512 as of Ice Lake. Earlier CPUs are slower with it, and the crate multiversion compiles no version for them. On these, a function
/// for AVX-512 would fall back to the version without vectors, in which a multiply-add is a function call.
#[cfg(target_arch = "x86_64")]
fn has_fast_avx512() -> bool {
    macro_rules! all {
        ($($feature:tt),*) => { true $(&& is_x86_feature_detected!($feature))* };
    }
    all!(
        "fma",
        "avx512bitalg",
        "avx512bw",
        "avx512cd",
        "avx512dq",
        "avx512f",
        "avx512ifma",
        "avx512vbmi",
        "avx512vbmi2",
        "avx512vl",
        "avx512vnni",
        "avx512vpopcntdq",
        "gfni",
        "vaes",
        "vpclmulqdq"
    )
}

/// W of the eight lanes, one full register. The compiler turns the loops into vector instructions if the calling code is compiled for them. Only
/// [`Vector::mul_add`] is fused.
#[derive(Clone, Copy)]
pub(super) struct Vector<const W: usize>([f64; W]);

impl<const W: usize> Vector<W> {
    /// Number of registers for eight lanes.
    pub const PER_CHUNK: usize = LANES / W;

    #[inline(always)]
    pub fn splat(value: f64) -> Self {
        Self([value; W])
    }

    /// Register `part` of the eight lanes.
    #[inline(always)]
    pub fn load(from: &Lanes, part: usize) -> Self {
        let mut values = [0.0; W];
        values.copy_from_slice(&from.0[part * W..(part + 1) * W]);
        Self(values)
    }

    /// Register `part` of three coordinates.
    #[inline(always)]
    pub fn load_all([x, y, z]: &[Lanes; 3], part: usize) -> [Self; 3] {
        [
            Self::load(x, part),
            Self::load(y, part),
            Self::load(z, part),
        ]
    }

    /// The smaller of the two, lane by lane.
    #[inline(always)]
    pub fn at_most(self, limit: f64) -> Self {
        Self(self.0.map(|v| if v < limit { v } else { limit }))
    }

    #[inline(always)]
    pub fn abs(self) -> Self {
        Self(self.0.map(f64::abs))
    }

    #[inline(always)]
    pub fn sqrt(self) -> Self {
        Self(self.0.map(f64::sqrt))
    }

    #[inline(always)]
    pub fn store(self, to: &mut Lanes, part: usize) {
        to.0[part * W..(part + 1) * W].copy_from_slice(&self.0);
    }

    #[inline(always)]
    pub fn store_at(self, to: &mut [f64], at: usize) {
        to[at..at + W].copy_from_slice(&self.0);
    }

    /// self · factor + addend, rounded once.
    #[inline(always)]
    pub fn mul_add(self, factor: Self, addend: Self) -> Self {
        let mut result = self;
        for i in 0..W {
            result.0[i] = self.0[i].mul_add(factor.0[i], addend.0[i]);
        }
        result
    }
}

impl<const W: usize> Add for Vector<W> {
    type Output = Self;
    #[inline(always)]
    fn add(self, other: Self) -> Self {
        let mut result = self;
        for i in 0..W {
            result.0[i] += other.0[i];
        }
        result
    }
}

impl<const W: usize> Sub for Vector<W> {
    type Output = Self;
    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        let mut result = self;
        for i in 0..W {
            result.0[i] -= other.0[i];
        }
        result
    }
}

impl<const W: usize> Mul for Vector<W> {
    type Output = Self;
    #[inline(always)]
    fn mul(self, other: Self) -> Self {
        let mut result = self;
        for i in 0..W {
            result.0[i] *= other.0[i];
        }
        result
    }
}

impl<const W: usize> Neg for Vector<W> {
    type Output = Self;
    #[inline(always)]
    fn neg(self) -> Self {
        let mut result = self;
        for i in 0..W {
            result.0[i] = -self.0[i];
        }
        result
    }
}
