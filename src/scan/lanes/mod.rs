//! The scan's trees for neighbouring windows at once, in the lanes of vector registers.
//!
//! The map is planar, so that one value of 16 or 32 windows side by side is one load. All seven nodes of a tree of depth
//! 3 are evaluated, masks select the number of the leaf, byte shuffles look the leaf up, sums are `i16`. A block of
//! windows goes on while more than one of them is alive; the last one is finished alone. Scores and windows are those of
//! [`Forest::cascade`](crate::trees::Forest::cascade) to the last bit.
//!
//! Instruction sets are those of the processor that runs the program: AVX2 or SSE4.1 on x86-64, NEON on AArch64.

#[cfg(feature = "simd")]
mod block;
mod instructions;
#[cfg(all(feature = "simd", target_arch = "aarch64"))]
mod neon;
mod prepared;
#[cfg(all(feature = "simd", target_arch = "x86_64"))]
mod x86;

#[cfg(feature = "simd")]
use prepared::Survivors;
use prepared::scalar;
#[cfg(all(feature = "simd", target_arch = "x86_64"))]
use x86::{avx2, sse41};

pub use instructions::Lanes;
pub use prepared::{Cascade, FEATURES, Windows, is_above, offset};

impl Cascade<'_> {
    /// Calls `found` for each window that the cascade does not reject with its column, row and score, row by row.
    pub fn scan(&self, windows: &Windows<'_>, mut found: impl FnMut(usize, usize, i32)) {
        let mut survivors = |column: usize, row: usize, tree: usize, score: i16| {
            if let Some(score) = self.rest(windows, column, row, tree, score) {
                found(column, row, score);
            }
        };
        match self.lanes {
            Lanes::Scalar => scalar(self, windows, &mut survivors),
            #[cfg(all(feature = "simd", target_arch = "x86_64"))]
            Lanes::Sse41 => in_sse41(self, windows, &mut survivors),
            #[cfg(all(feature = "simd", target_arch = "x86_64"))]
            Lanes::Avx2 => in_avx2(self, windows, &mut survivors),
            #[cfg(all(feature = "simd", target_arch = "aarch64"))]
            Lanes::Neon => in_neon(self, windows, &mut survivors),
        }
    }
}

#[cfg(all(feature = "simd", target_arch = "x86_64"))]
#[multiversion::multiversion(targets("x86_64+sse4.1"))]
fn in_sse41(cascade: &Cascade<'_>, windows: &Windows<'_>, survivors: Survivors<'_>) {
    multiversion::target::match_target! {
        "x86_64+sse4.1" => sse41::rows(cascade, windows, survivors),
        _ => scalar(cascade, windows, survivors),
    }
}

#[cfg(all(feature = "simd", target_arch = "x86_64"))]
#[multiversion::multiversion(targets("x86_64+avx2"))]
fn in_avx2(cascade: &Cascade<'_>, windows: &Windows<'_>, survivors: Survivors<'_>) {
    multiversion::target::match_target! {
        "x86_64+avx2" => avx2::rows(cascade, windows, survivors),
        _ => scalar(cascade, windows, survivors),
    }
}

/// NEON is part of every AArch64 target, for which `multiversion` makes no clone with features of its own, and without one
/// the intrinsics are not to be called without `unsafe`. CRC instructions, which every processor of a companion board has
/// (all from ARMv8.1 on, Cortex-A53 and A72 before), make it one.
#[cfg(all(feature = "simd", target_arch = "aarch64"))]
#[multiversion::multiversion(targets("aarch64+neon+crc"))]
fn in_neon(cascade: &Cascade<'_>, windows: &Windows<'_>, survivors: Survivors<'_>) {
    multiversion::target::match_target! {
        "aarch64+neon+crc" => neon::rows(cascade, windows, survivors),
        _ => scalar(cascade, windows, survivors),
    }
}

#[cfg(test)]
mod tests;
