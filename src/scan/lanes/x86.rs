//! The operations of x86-64.
//!
//! Bytes of a map are signed since there is one instruction that compares those, and two for others. The mean of a value and
//! a constant, whose first bit is the same answer, is no way round: the compiler takes it apart.

/// Operations on 16 bytes and 16 sums.
pub mod sse41 {
    use crate::scan::lanes::block::in_lanes;
    use crate::scan::lanes::prepared::{Cascade, Prepared, Survivors, Windows, scalar};
    use core::arch::x86_64::*;

    const LANES: usize = 16;
    type Bytes = __m128i;
    type Sums = [__m128i; 2];

    in_lanes!("sse4.1");

    #[inline]
    #[target_feature(enable = "sse4.1")]
    fn load(bytes: &[u8]) -> Bytes {
        let (halves, _) = bytes.as_chunks::<8>();
        _mm_set_epi64x(i64::from_le_bytes(halves[1]), i64::from_le_bytes(halves[0]))
    }

    #[inline]
    #[target_feature(enable = "sse4.1")]
    fn lanes_from(first: usize) -> Bytes {
        load(&core::array::from_fn::<u8, LANES, _>(|lane| if lane < first { 0 } else { 255 }))
    }

    #[inline]
    #[target_feature(enable = "sse4.1")]
    fn splat_sums(sum: i16) -> Sums {
        [_mm_set1_epi16(sum); 2]
    }

    #[inline]
    #[target_feature(enable = "sse4.1")]
    fn step(value: Bytes, prepared: &Prepared, node: usize) -> Bytes {
        _mm_cmpgt_epi8(_mm_set1_epi8(prepared.limits[node]), value)
    }

    #[inline]
    #[target_feature(enable = "sse4.1")]
    fn pick(left: Bytes, a: Bytes, b: Bytes) -> Bytes {
        _mm_blendv_epi8(b, a, left)
    }

    /// Low and high bytes of the leaves.
    #[inline]
    #[target_feature(enable = "sse4.1")]
    fn leaves(prepared: &Prepared, a: Bytes, b: Bytes, c: Bytes) -> (Bytes, Bytes) {
        // The leaf's number from masks of the steps to the left, -1 each, is 7 + 4 a + 2 b + c; twice that is its place.
        let number = _mm_add_epi8(_mm_add_epi8(a, a), b);
        let number = _mm_add_epi8(_mm_add_epi8(number, number), c);
        let place = _mm_add_epi8(number, number);
        let table = load(prepared.leaves.as_flattened());
        (
            _mm_shuffle_epi8(table, _mm_add_epi8(place, _mm_set1_epi8(14))),
            _mm_shuffle_epi8(table, _mm_add_epi8(place, _mm_set1_epi8(15))),
        )
    }

    #[inline]
    #[target_feature(enable = "sse4.1")]
    fn add(sums: Sums, low: Bytes, high: Bytes) -> Sums {
        [
            _mm_add_epi16(sums[0], _mm_unpacklo_epi8(low, high)),
            _mm_add_epi16(sums[1], _mm_unpackhi_epi8(low, high)),
        ]
    }

    #[inline]
    #[target_feature(enable = "sse4.1")]
    fn and_not_below(alive: Bytes, sums: Sums, reject: i16) -> Bytes {
        let below = sums.map(|sums| _mm_cmpgt_epi16(_mm_set1_epi16(reject), sums));
        _mm_andnot_si128(_mm_packs_epi16(below[0], below[1]), alive)
    }

    #[inline]
    #[target_feature(enable = "sse4.1")]
    fn to_mask(alive: Bytes) -> u32 {
        _mm_movemask_epi8(alive).cast_unsigned()
    }

    #[inline]
    #[target_feature(enable = "sse4.1")]
    fn to_array(sums: Sums) -> [i16; LANES] {
        let [a, b] = sums;
        let words = [
            _mm_extract_epi64::<0>(a),
            _mm_extract_epi64::<1>(a),
            _mm_extract_epi64::<0>(b),
            _mm_extract_epi64::<1>(b),
        ];
        core::array::from_fn(|lane| (words[lane / 4] >> (lane % 4 * 16)) as i16)
    }
}

/// Operations on 32 bytes and 32 sums. Instructions that widen bytes take the lower and the upper half of the lanes each
/// by itself: the first sums are those of lanes 0 to 7 and 16 to 23.
pub mod avx2 {
    use crate::scan::lanes::block::in_lanes;
    use crate::scan::lanes::prepared::{Cascade, Prepared, Survivors, Windows, scalar};
    use core::arch::x86_64::*;

    const LANES: usize = 32;
    type Bytes = __m256i;
    type Sums = [__m256i; 2];

    in_lanes!("avx2");

    #[inline]
    #[target_feature(enable = "avx2")]
    fn load(bytes: &[u8]) -> Bytes {
        let (parts, _) = bytes.as_chunks::<8>();
        let part = |n: usize| i64::from_le_bytes(parts[n]);
        _mm256_set_epi64x(part(3), part(2), part(1), part(0))
    }

    #[inline]
    #[target_feature(enable = "avx2")]
    fn lanes_from(first: usize) -> Bytes {
        load(&core::array::from_fn::<u8, LANES, _>(|lane| if lane < first { 0 } else { 255 }))
    }

    #[inline]
    #[target_feature(enable = "avx2")]
    fn splat_sums(sum: i16) -> Sums {
        [_mm256_set1_epi16(sum); 2]
    }

    #[inline]
    #[target_feature(enable = "avx2")]
    fn step(value: Bytes, prepared: &Prepared, node: usize) -> Bytes {
        _mm256_cmpgt_epi8(_mm256_set1_epi8(prepared.limits[node]), value)
    }

    #[inline]
    #[target_feature(enable = "avx2")]
    fn pick(left: Bytes, a: Bytes, b: Bytes) -> Bytes {
        _mm256_blendv_epi8(b, a, left)
    }

    /// Low and high bytes of the leaves.
    #[inline]
    #[target_feature(enable = "avx2")]
    fn leaves(prepared: &Prepared, a: Bytes, b: Bytes, c: Bytes) -> (Bytes, Bytes) {
        // The leaf's number from masks of the steps to the left, -1 each, is 7 + 4 a + 2 b + c; twice that is its place.
        let number = _mm256_add_epi8(_mm256_add_epi8(a, a), b);
        let number = _mm256_add_epi8(_mm256_add_epi8(number, number), c);
        let place = _mm256_add_epi8(number, number);
        let (parts, _) = prepared.leaves.as_flattened().as_chunks::<8>();
        let (low, high) = (i64::from_le_bytes(parts[0]), i64::from_le_bytes(parts[1]));
        let table = _mm256_set_epi64x(high, low, high, low);
        (
            _mm256_shuffle_epi8(table, _mm256_add_epi8(place, _mm256_set1_epi8(14))),
            _mm256_shuffle_epi8(table, _mm256_add_epi8(place, _mm256_set1_epi8(15))),
        )
    }

    #[inline]
    #[target_feature(enable = "avx2")]
    fn add(sums: Sums, low: Bytes, high: Bytes) -> Sums {
        [
            _mm256_add_epi16(sums[0], _mm256_unpacklo_epi8(low, high)),
            _mm256_add_epi16(sums[1], _mm256_unpackhi_epi8(low, high)),
        ]
    }

    #[inline]
    #[target_feature(enable = "avx2")]
    fn and_not_below(alive: Bytes, sums: Sums, reject: i16) -> Bytes {
        let below = sums.map(|sums| _mm256_cmpgt_epi16(_mm256_set1_epi16(reject), sums));
        _mm256_andnot_si256(_mm256_packs_epi16(below[0], below[1]), alive)
    }

    #[inline]
    #[target_feature(enable = "avx2")]
    fn to_mask(alive: Bytes) -> u32 {
        _mm256_movemask_epi8(alive).cast_unsigned()
    }

    #[inline]
    #[target_feature(enable = "avx2")]
    fn to_array([a, b]: Sums) -> [i16; LANES] {
        let words = [
            _mm256_extract_epi64::<0>(a),
            _mm256_extract_epi64::<1>(a),
            _mm256_extract_epi64::<0>(b),
            _mm256_extract_epi64::<1>(b),
            _mm256_extract_epi64::<2>(a),
            _mm256_extract_epi64::<3>(a),
            _mm256_extract_epi64::<2>(b),
            _mm256_extract_epi64::<3>(b),
        ];
        core::array::from_fn(|lane| (words[lane / 4] >> (lane % 4 * 16)) as i16)
    }
}
