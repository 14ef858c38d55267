//! Instruction sets with lanes, and which of them a processor has.

/// An instruction set for the lanes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Lanes {
    /// One window after the other.
    Scalar,
    /// 16 windows, x86-64 with SSE4.1.
    #[cfg(all(feature = "simd", target_arch = "x86_64"))]
    Sse41,
    /// 32 windows, x86-64 with AVX2.
    #[cfg(all(feature = "simd", target_arch = "x86_64"))]
    Avx2,
    /// 16 windows, AArch64 with NEON.
    #[cfg(all(feature = "simd", target_arch = "aarch64"))]
    Neon,
}

impl Lanes {
    /// All that this processor can execute, the fastest first.
    pub fn available() -> impl Iterator<Item = Self> {
        let all = [
            #[cfg(all(feature = "simd", target_arch = "x86_64"))]
            (Self::Avx2, std::arch::is_x86_feature_detected!("avx2")),
            #[cfg(all(feature = "simd", target_arch = "x86_64"))]
            (Self::Sse41, std::arch::is_x86_feature_detected!("sse4.1")),
            #[cfg(all(feature = "simd", target_arch = "aarch64"))]
            (Self::Neon, std::arch::is_aarch64_feature_detected!("crc")),
            (Self::Scalar, true),
        ];
        all.into_iter().filter_map(|(lanes, available)| available.then_some(lanes))
    }

    /// The fastest of [`Lanes::available`].
    pub fn fastest() -> Self {
        Self::available().next().unwrap_or(Self::Scalar)
    }

    /// The name in reports.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Scalar => "scalar",
            #[cfg(all(feature = "simd", target_arch = "x86_64"))]
            Self::Sse41 => "SSE4.1",
            #[cfg(all(feature = "simd", target_arch = "x86_64"))]
            Self::Avx2 => "AVX2",
            #[cfg(all(feature = "simd", target_arch = "aarch64"))]
            Self::Neon => "NEON",
        }
    }
}
