//! Fixed-point helpers. Names of values end in their format: `_q8` has 8 fraction bits.

/// `2^(i/32)` in Q16.
static EXP2: [u32; 33] = [
    65536, 66971, 68438, 69936, 71468, 73032, 74632, 76266, 77936, 79642, 81386, 83169, 84990,
    86851, 88752, 90696, 92682, 94711, 96785, 98905, 101070, 103283, 105545, 107856, 110218,
    112631, 115098, 117618, 120194, 122825, 125515, 128263, 131072,
];

/// 2^x in Q16 of x in Q8, which is clamped to -4.0..=4.0. Interpolated linearly over 1/32; error below 0.01 %.
pub fn exp2_q16(x_q8: i32) -> u32 {
    let x = x_q8.clamp(-1024, 1024);
    let (whole, part) = (x.div_euclid(256), x.rem_euclid(256) as usize);
    let (step, rest) = (part / 8, (part % 8) as u32);
    let mantissa = EXP2[step] + ((EXP2[step + 1] - EXP2[step]) * rest + 4) / 8;
    if whole >= 0 { mantissa << whole } else { mantissa >> -whole }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exp2_agrees_with_f64() {
        for x in -1024..=1024 {
            let want = (f64::from(x) / 256.0).exp2() * 65536.0;
            assert!((f64::from(exp2_q16(x)) - want).abs() < 1.0 + want * 1e-4, "{x}");
        }
        assert_eq!(exp2_q16(i32::MAX), 16 << 16);
        assert_eq!(exp2_q16(i32::MIN), 4096);
    }
}
