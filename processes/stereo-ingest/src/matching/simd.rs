//! Vectors of bytes, one type for each instruction set, and the choice among them at run time.
//!
//! [`Lanes`] is the small set of operations that the matching kernels are written in. [`Portable`] is plain Rust that
//! compilers turn into SSE2 or NEON; the others are intrinsics. Every operation is exact, so results do not depend on
//! the choice. Nothing here knows about stereo.
//!
//! # Safety
//! Values of a type are made only after [`SimdLevel::is_available`] said that the machine has its instructions: the matcher
//! asserts that before it builds anything of the type, and [`Lanes::enter`] before it runs a kernel.

/// An instruction set that the matcher can use.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SimdLevel {
    /// Plain Rust, 16 bytes at a time: SSE2 on x86-64, NEON on Arm.
    Portable,
    /// 32 bytes at a time.
    Avx2,
    /// 64 bytes at a time (F, BW, VBMI, BITALG: Ice Lake, Zen 4 and newer).
    Avx512,
}

impl SimdLevel {
    /// All levels, slowest first.
    pub const ALL: [Self; 3] = [Self::Portable, Self::Avx2, Self::Avx512];

    /// Whether this machine has it.
    pub fn is_available(self) -> bool {
        match self {
            Self::Portable => true,
            #[cfg(target_arch = "x86_64")]
            Self::Avx2 => {
                is_x86_feature_detected!("avx2")
                    && is_x86_feature_detected!("popcnt")
                    && is_x86_feature_detected!("bmi1")
                    && is_x86_feature_detected!("bmi2")
                    && is_x86_feature_detected!("lzcnt")
            }
            #[cfg(target_arch = "x86_64")]
            Self::Avx512 => {
                Self::Avx2.is_available()
                    && is_x86_feature_detected!("avx512f")
                    && is_x86_feature_detected!("avx512bw")
                    && is_x86_feature_detected!("avx512vbmi")
                    && is_x86_feature_detected!("avx512bitalg")
            }
            #[cfg(not(target_arch = "x86_64"))]
            _ => false,
        }
    }

    /// The fastest that this machine has.
    pub fn best() -> Self {
        Self::ALL.into_iter().rev().find(|level| level.is_available()).unwrap_or(Self::Portable)
    }
}

/// What is compiled anew for each instruction set. Not a closure, which could not be told to be inlined.
pub(crate) trait Kernel {
    /// To be marked `#[inline(always)]`, as everything that it calls.
    fn run(self);
}

/// A vector of [`Lanes::COUNT`] unsigned bytes.
pub(crate) trait Lanes: Copy + Send + 'static {
    /// Bytes in a vector, at most 64.
    const COUNT: usize;

    /// Runs `kernel` compiled for this type's instructions, which the machine must have.
    fn enter(kernel: impl Kernel);

    fn splat(value: u8) -> Self;
    /// The first [`Lanes::COUNT`] bytes of a slice, which must have as many.
    fn load(bytes: &[u8]) -> Self;
    fn store(self, bytes: &mut [u8]);
    fn xor(self, other: Self) -> Self;
    fn min(self, other: Self) -> Self;
    /// Wrapping sum and difference.
    fn add(self, other: Self) -> Self;
    fn sub(self, other: Self) -> Self;
    /// Sum and difference that stop at 255 and 0.
    fn add_saturating(self, other: Self) -> Self;
    fn sub_saturating(self, other: Self) -> Self;
    fn count_ones(self) -> Self;
    /// Each byte shifted right by `bits`, 0 to 7.
    fn shift_right(self, bits: u32) -> Self;
    /// Lane i takes lane i − 1; lane 0 takes the last lane of `before`.
    fn take_below(self, before: Self) -> Self;
    /// Lane i takes lane i + 1; the last lane takes lane 0 of `after`.
    fn take_above(self, after: Self) -> Self;
    /// The smallest lane, in every lane.
    fn least(self) -> Self;
    /// The first lane.
    fn first(self) -> u8;
    /// Bit i is set where lane i is equal.
    fn equal(self, other: Self) -> u64;
}

/// Sixteen bytes in plain Rust.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(16))]
pub(crate) struct Portable([u8; 16]);

impl Portable {
    #[inline(always)]
    fn zip(mut self, other: Self, f: impl Fn(u8, u8) -> u8) -> Self {
        for (a, b) in self.0.iter_mut().zip(other.0) {
            *a = f(*a, b);
        }
        self
    }
}

impl Lanes for Portable {
    const COUNT: usize = 16;

    #[inline(always)]
    fn enter(kernel: impl Kernel) {
        kernel.run();
    }
    #[inline(always)]
    fn splat(value: u8) -> Self {
        Self([value; 16])
    }
    #[inline(always)]
    fn load(bytes: &[u8]) -> Self {
        let mut out = [0; 16];
        out.copy_from_slice(&bytes[..16]);
        Self(out)
    }
    #[inline(always)]
    fn store(self, bytes: &mut [u8]) {
        bytes[..16].copy_from_slice(&self.0);
    }
    #[inline(always)]
    fn xor(self, other: Self) -> Self {
        self.zip(other, |a, b| a ^ b)
    }
    #[inline(always)]
    fn min(self, other: Self) -> Self {
        self.zip(other, u8::min)
    }
    #[inline(always)]
    fn add(self, other: Self) -> Self {
        self.zip(other, u8::wrapping_add)
    }
    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        self.zip(other, u8::wrapping_sub)
    }
    #[inline(always)]
    fn add_saturating(self, other: Self) -> Self {
        self.zip(other, u8::saturating_add)
    }
    #[inline(always)]
    fn sub_saturating(self, other: Self) -> Self {
        self.zip(other, u8::saturating_sub)
    }
    #[inline(always)]
    fn count_ones(self) -> Self {
        self.zip(self, |a, _| a.count_ones() as u8)
    }
    #[inline(always)]
    fn shift_right(self, bits: u32) -> Self {
        self.zip(self, |a, _| a >> bits)
    }
    #[inline(always)]
    fn take_below(self, before: Self) -> Self {
        let mut out = [before.0[15]; 16];
        out[1..].copy_from_slice(&self.0[..15]);
        Self(out)
    }
    #[inline(always)]
    fn take_above(self, after: Self) -> Self {
        let mut out = [after.0[0]; 16];
        out[..15].copy_from_slice(&self.0[1..]);
        Self(out)
    }
    #[inline(always)]
    fn least(self) -> Self {
        let mut least = self.0;
        for width in [8, 4, 2, 1] {
            for i in 0..width {
                least[i] = least[i].min(least[i + width]);
            }
        }
        Self([least[0]; 16])
    }
    #[inline(always)]
    fn first(self) -> u8 {
        self.0[0]
    }
    #[inline(always)]
    fn equal(self, other: Self) -> u64 {
        let mut mask = 0;
        for i in 0..16 {
            mask |= u64::from(self.0[i] == other.0[i]) << i;
        }
        mask
    }
}

#[cfg(target_arch = "x86_64")]
pub(crate) use x86::{Avx2, Avx512};

#[cfg(target_arch = "x86_64")]
mod x86 {
    #![allow(unsafe_code)]
    use super::{Kernel, Lanes, SimdLevel};
    use std::arch::x86_64::*;

    /// Calls intrinsics. Contract: a value of the type exists, so the machine was asked whether it has the instructions
    /// (see the module's safety section); loads and stores first take a slice of the vector's length.
    macro_rules! intrinsic {
        ($call:expr) => {
            // SAFETY: see the macro's contract.
            unsafe { $call }
        };
    }

    /// 32 bytes.
    #[derive(Clone, Copy, Debug)]
    pub(crate) struct Avx2(__m256i);

    /// 64 bytes.
    #[derive(Clone, Copy, Debug)]
    pub(crate) struct Avx512(__m512i);

    /// The smallest of 16 bytes as the lowest byte, by the instruction that finds the smallest of eight words.
    #[inline(always)]
    fn least_of_16(v: __m128i) -> __m128i {
        // The shift leaves zeros in the high bytes, so the smaller of both is a word.
        intrinsic!(_mm_minpos_epu16(_mm_min_epu8(v, _mm_srli_epi16::<8>(v))))
    }

    impl Lanes for Avx2 {
        const COUNT: usize = 32;

        #[inline(always)]
        fn enter(kernel: impl Kernel) {
            assert!(SimdLevel::Avx2.is_available(), "entered without the instructions");
            #[target_feature(enable = "avx2,popcnt,bmi1,bmi2,lzcnt")]
            fn inner(kernel: impl Kernel) {
                kernel.run();
            }
            // SAFETY: just asserted.
            unsafe { inner(kernel) };
        }
        #[inline(always)]
        fn splat(value: u8) -> Self {
            Self(intrinsic!(_mm256_set1_epi8(value as i8)))
        }
        #[inline(always)]
        fn load(bytes: &[u8]) -> Self {
            let bytes = &bytes[..32];
            Self(intrinsic!(_mm256_loadu_si256(bytes.as_ptr().cast())))
        }
        #[inline(always)]
        fn store(self, bytes: &mut [u8]) {
            let bytes = &mut bytes[..32];
            intrinsic!(_mm256_storeu_si256(bytes.as_mut_ptr().cast(), self.0));
        }
        #[inline(always)]
        fn xor(self, other: Self) -> Self {
            Self(intrinsic!(_mm256_xor_si256(self.0, other.0)))
        }
        #[inline(always)]
        fn min(self, other: Self) -> Self {
            Self(intrinsic!(_mm256_min_epu8(self.0, other.0)))
        }
        #[inline(always)]
        fn add(self, other: Self) -> Self {
            Self(intrinsic!(_mm256_add_epi8(self.0, other.0)))
        }
        #[inline(always)]
        fn sub(self, other: Self) -> Self {
            Self(intrinsic!(_mm256_sub_epi8(self.0, other.0)))
        }
        #[inline(always)]
        fn add_saturating(self, other: Self) -> Self {
            Self(intrinsic!(_mm256_adds_epu8(self.0, other.0)))
        }
        #[inline(always)]
        fn sub_saturating(self, other: Self) -> Self {
            Self(intrinsic!(_mm256_subs_epu8(self.0, other.0)))
        }
        #[inline(always)]
        fn count_ones(self) -> Self {
            Self(intrinsic!({
                let table = _mm256_setr_epi8(
                    0, 1, 1, 2, 1, 2, 2, 3, 1, 2, 2, 3, 2, 3, 3, 4, 0, 1, 1, 2, 1, 2, 2, 3, 1, 2, 2, 3, 2, 3, 3, 4,
                );
                let nibble = _mm256_set1_epi8(15);
                let low = _mm256_shuffle_epi8(table, _mm256_and_si256(self.0, nibble));
                let high = _mm256_and_si256(_mm256_srli_epi16::<4>(self.0), nibble);
                _mm256_add_epi8(low, _mm256_shuffle_epi8(table, high))
            }))
        }
        #[inline(always)]
        fn shift_right(self, bits: u32) -> Self {
            Self(intrinsic!({
                let shifted = _mm256_srl_epi16(self.0, _mm_cvtsi32_si128(bits as i32));
                _mm256_and_si256(shifted, _mm256_set1_epi8((0xff_u8 >> bits) as i8))
            }))
        }
        #[inline(always)]
        fn take_below(self, before: Self) -> Self {
            Self(intrinsic!({
                let halves = _mm256_permute2x128_si256::<0x21>(before.0, self.0);
                _mm256_alignr_epi8::<15>(self.0, halves)
            }))
        }
        #[inline(always)]
        fn take_above(self, after: Self) -> Self {
            Self(intrinsic!({
                let halves = _mm256_permute2x128_si256::<0x21>(self.0, after.0);
                _mm256_alignr_epi8::<1>(halves, self.0)
            }))
        }
        #[inline(always)]
        fn least(self) -> Self {
            Self(intrinsic!({
                let half = _mm_min_epu8(_mm256_castsi256_si128(self.0), _mm256_extracti128_si256::<1>(self.0));
                _mm256_broadcastb_epi8(least_of_16(half))
            }))
        }
        #[inline(always)]
        fn first(self) -> u8 {
            intrinsic!(_mm_cvtsi128_si32(_mm256_castsi256_si128(self.0))) as u8
        }
        #[inline(always)]
        fn equal(self, other: Self) -> u64 {
            u64::from(intrinsic!(_mm256_movemask_epi8(_mm256_cmpeq_epi8(self.0, other.0))) as u32)
        }
    }

    impl Lanes for Avx512 {
        const COUNT: usize = 64;

        #[inline(always)]
        fn enter(kernel: impl Kernel) {
            assert!(SimdLevel::Avx512.is_available(), "entered without the instructions");
            #[target_feature(enable = "avx512f,avx512bw,avx512vbmi,avx512bitalg,avx2,popcnt,bmi1,bmi2,lzcnt")]
            fn inner(kernel: impl Kernel) {
                kernel.run();
            }
            // SAFETY: just asserted.
            unsafe { inner(kernel) };
        }
        #[inline(always)]
        fn splat(value: u8) -> Self {
            Self(intrinsic!(_mm512_set1_epi8(value as i8)))
        }
        #[inline(always)]
        fn load(bytes: &[u8]) -> Self {
            let bytes = &bytes[..64];
            Self(intrinsic!(_mm512_loadu_si512(bytes.as_ptr().cast())))
        }
        #[inline(always)]
        fn store(self, bytes: &mut [u8]) {
            let bytes = &mut bytes[..64];
            intrinsic!(_mm512_storeu_si512(bytes.as_mut_ptr().cast(), self.0));
        }
        #[inline(always)]
        fn xor(self, other: Self) -> Self {
            Self(intrinsic!(_mm512_xor_si512(self.0, other.0)))
        }
        #[inline(always)]
        fn min(self, other: Self) -> Self {
            Self(intrinsic!(_mm512_min_epu8(self.0, other.0)))
        }
        #[inline(always)]
        fn add(self, other: Self) -> Self {
            Self(intrinsic!(_mm512_add_epi8(self.0, other.0)))
        }
        #[inline(always)]
        fn sub(self, other: Self) -> Self {
            Self(intrinsic!(_mm512_sub_epi8(self.0, other.0)))
        }
        #[inline(always)]
        fn add_saturating(self, other: Self) -> Self {
            Self(intrinsic!(_mm512_adds_epu8(self.0, other.0)))
        }
        #[inline(always)]
        fn sub_saturating(self, other: Self) -> Self {
            Self(intrinsic!(_mm512_subs_epu8(self.0, other.0)))
        }
        #[inline(always)]
        fn count_ones(self) -> Self {
            Self(intrinsic!(_mm512_popcnt_epi8(self.0)))
        }
        #[inline(always)]
        fn shift_right(self, bits: u32) -> Self {
            Self(intrinsic!({
                let shifted = _mm512_srl_epi16(self.0, _mm_cvtsi32_si128(bits as i32));
                _mm512_and_si512(shifted, _mm512_set1_epi8((0xff_u8 >> bits) as i8))
            }))
        }
        #[inline(always)]
        fn take_below(self, before: Self) -> Self {
            Self(intrinsic!({
                let quarters = _mm512_alignr_epi64::<6>(self.0, before.0);
                _mm512_alignr_epi8::<15>(self.0, quarters)
            }))
        }
        #[inline(always)]
        fn take_above(self, after: Self) -> Self {
            Self(intrinsic!({
                let quarters = _mm512_alignr_epi64::<2>(after.0, self.0);
                _mm512_alignr_epi8::<1>(quarters, self.0)
            }))
        }
        #[inline(always)]
        fn least(self) -> Self {
            Self(intrinsic!({
                let half = _mm256_min_epu8(_mm512_castsi512_si256(self.0), _mm512_extracti64x4_epi64::<1>(self.0));
                let quarter = _mm_min_epu8(_mm256_castsi256_si128(half), _mm256_extracti128_si256::<1>(half));
                _mm512_broadcastb_epi8(least_of_16(quarter))
            }))
        }
        #[inline(always)]
        fn first(self) -> u8 {
            intrinsic!(_mm_cvtsi128_si32(_mm512_castsi512_si128(self.0))) as u8
        }
        #[inline(always)]
        fn equal(self, other: Self) -> u64 {
            intrinsic!(_mm512_cmpeq_epi8_mask(self.0, other.0))
        }
    }
}
