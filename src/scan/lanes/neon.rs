//! The operations of AArch64 with NEON, on 16 bytes and 16 sums.

use crate::scan::lanes::block::in_lanes;
use crate::scan::lanes::prepared::{Cascade, Prepared, Survivors, Windows, scalar};
use core::arch::aarch64::*;

const LANES: usize = 16;
type Bytes = uint8x16_t;
type Sums = [int16x8_t; 2];

in_lanes!("neon");

#[inline]
#[target_feature(enable = "neon")]
fn load(bytes: &[u8]) -> Bytes {
    let (halves, _) = bytes.as_chunks::<8>();
    let half = |n: usize| vcreate_u8(u64::from_le_bytes(halves[n]));
    vcombine_u8(half(0), half(1))
}

#[inline]
#[target_feature(enable = "neon")]
fn lanes_from(first: usize) -> Bytes {
    load(&core::array::from_fn::<u8, LANES, _>(|lane| if lane < first { 0 } else { 255 }))
}

#[inline]
#[target_feature(enable = "neon")]
fn splat_sums(sum: i16) -> Sums {
    [vdupq_n_s16(sum); 2]
}

#[inline]
#[target_feature(enable = "neon")]
fn step(value: Bytes, prepared: &Prepared, node: usize) -> Bytes {
    vcltq_s8(vreinterpretq_s8_u8(value), vdupq_n_s8(prepared.limits[node]))
}

#[inline]
#[target_feature(enable = "neon")]
fn pick(left: Bytes, a: Bytes, b: Bytes) -> Bytes {
    vbslq_u8(left, a, b)
}

/// Low and high bytes of the leaves.
#[inline]
#[target_feature(enable = "neon")]
fn leaves(prepared: &Prepared, a: Bytes, b: Bytes, c: Bytes) -> (Bytes, Bytes) {
    // The leaf's number from masks of the steps to the left, -1 each, is 7 + 4 a + 2 b + c; twice that is its place.
    let number = vaddq_u8(vaddq_u8(a, a), b);
    let number = vaddq_u8(vaddq_u8(number, number), c);
    let place = vaddq_u8(number, number);
    let table = load(prepared.leaves.as_flattened());
    (
        vqtbl1q_u8(table, vaddq_u8(place, vdupq_n_u8(14))),
        vqtbl1q_u8(table, vaddq_u8(place, vdupq_n_u8(15))),
    )
}

#[inline]
#[target_feature(enable = "neon")]
fn add(sums: Sums, low: Bytes, high: Bytes) -> Sums {
    [
        vaddq_s16(sums[0], vreinterpretq_s16_u8(vzip1q_u8(low, high))),
        vaddq_s16(sums[1], vreinterpretq_s16_u8(vzip2q_u8(low, high))),
    ]
}

#[inline]
#[target_feature(enable = "neon")]
fn and_not_below(alive: Bytes, sums: Sums, reject: i16) -> Bytes {
    let reject = vdupq_n_s16(reject);
    let [a, b] = sums.map(|sums| vreinterpretq_u8_u16(vcgeq_s16(sums, reject)));
    // Of each mask one byte.
    vandq_u8(alive, vuzp1q_u8(a, b))
}

#[inline]
#[target_feature(enable = "neon")]
fn to_mask(alive: Bytes) -> u32 {
    // Four bits of each lane, of which one is kept.
    let bits = vshrn_n_u16::<4>(vreinterpretq_u16_u8(alive));
    let bits = vget_lane_u64::<0>(vreinterpret_u64_u8(bits)) & 0x1111_1111_1111_1111;
    // Pairs of nibbles, then of bytes and so on, move together.
    let bits = (bits | bits >> 3) & 0x0303_0303_0303_0303;
    let bits = (bits | bits >> 6) & 0x000f_000f_000f_000f;
    let bits = (bits | bits >> 12) & 0x0000_00ff_0000_00ff;
    (bits | bits >> 24) as u32 & 0xffff
}

#[inline]
#[target_feature(enable = "neon")]
fn to_array([a, b]: Sums) -> [i16; LANES] {
    let words = [
        vgetq_lane_s64::<0>(vreinterpretq_s64_s16(a)),
        vgetq_lane_s64::<1>(vreinterpretq_s64_s16(a)),
        vgetq_lane_s64::<0>(vreinterpretq_s64_s16(b)),
        vgetq_lane_s64::<1>(vreinterpretq_s64_s16(b)),
    ];
    core::array::from_fn(|lane| (words[lane / 4] >> (lane % 4 * 16)) as i16)
}
