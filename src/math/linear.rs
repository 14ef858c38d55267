//! Small systems of linear equations in integers.

/// Bits by which the matrix is scaled up while it is reduced, so that rounding stays far below one unit of it.
const GUARD: u32 = 16;

/// Solves `a x = b` for the first `n` unknowns by Gaussian elimination without pivoting, which is stable because `a`
/// has to be symmetric and positive definite (only its upper triangle is read). The unknowns come in Q`bits`, the
/// others are 0. `None` if the matrix is not positive definite.
///
/// For the normal equations of a least-squares problem: `a` and `b` below 2^46 in magnitude, `n <= N`, `bits <= 32`.
pub fn solve<const N: usize>(
    a: &[[i64; N]; N],
    b: &[i64; N],
    n: usize,
    bits: u32,
) -> Option<[i64; N]> {
    let n = n.min(N);
    let mut a = a.map(|row| row.map(|v| i128::from(v) << GUARD));
    let mut b = b.map(|v| i128::from(v) << GUARD);
    for k in 0..n {
        if a[k][k] <= 0 {
            return None;
        }
        for i in k + 1..n {
            let factor = a[k][i];
            for j in i..n {
                a[i][j] -= divide(factor * a[k][j], a[k][k]);
            }
            b[i] -= divide(factor * b[k], a[k][k]);
        }
    }
    let mut x = [0i128; N];
    for k in (0..n).rev() {
        let known: i128 = (k + 1..n).map(|j| a[k][j] * x[j]).sum();
        // 2^47 is far beyond any use and keeps the sums above in range.
        x[k] = divide((b[k] << bits) - known, a[k][k]).clamp(-1 << 47, 1 << 47);
    }
    Some(x.map(|v| v as i64))
}

/// Quotient rounded to nearest, for a divisor from 1 to 2^63 - 1.
fn divide(a: i128, b: i128) -> i128 {
    let (sum, b) = (a + b / 2, b as u64);
    if sum < 0 { !quotient((!sum).cast_unsigned(), b) } else { quotient(sum.cast_unsigned(), b) }
}

/// Quotient rounded down, for a divisor from 1 to 2^63 - 1 and a dividend below 2^127: long division by digits of 32 bits
/// (Knuth, TAOCP 2, 4.3.1 D), since on a machine of 32 bits a division of 128 is done bit by bit.
fn quotient(a: u128, b: u64) -> i128 {
    let Some(shift) = b.checked_ilog2().map(|log| 63 - log) else { return 0 };
    let high = (a >> 64) as u64;
    // With the divisor's first bit set, its first two digits give a digit of the quotient that is at most two too large.
    let (first, divisor) = (high / b, b << shift);
    let rest = (u128::from(high % b) << 64 | u128::from(a as u64)) << shift;
    let (upper, lower) = (divisor >> 32, divisor & 0xffff_ffff);
    let digit = |remainder: u64, next: u64| {
        let (mut digit, mut over) = (remainder / upper, remainder % upper);
        while digit >> 32 != 0 || digit * lower > over << 32 | next {
            (digit, over) = (digit - 1, over + upper);
            if over >> 32 != 0 {
                break;
            }
        }
        // Smaller than the divisor: what wraps on the way is right in the end.
        let left = (remainder << 32 | next).wrapping_sub(digit.wrapping_mul(divisor));
        (digit, left)
    };
    let low = rest as u64;
    let (second, left) = digit((rest >> 64) as u64, low >> 32);
    let (third, _) = digit(left, low & 0xffff_ffff);
    i128::from(first) << 64 | i128::from(second << 32 | third)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn quotients_are_those_of_i128(a: i128, down in 2..127u32, b in 1..i64::MAX, shift in 0..62u32) {
            let (a, b) = (a >> down, i128::from((b >> shift).max(1)));
            prop_assert_eq!(divide(a, b), (a + b / 2).div_euclid(b));
            let edge = b * (a >> 64);
            prop_assert_eq!(divide(edge, b), (edge + b / 2).div_euclid(b));
            prop_assert_eq!(divide(edge - 1, b), (edge - 1 + b / 2).div_euclid(b));
        }

        #[test]
        fn solves_normal_equations(rows in proptest::collection::vec(proptest::array::uniform4(-4096..4096i64), 8..40), x in proptest::array::uniform4(-500..500i64)) {
            let mut a = [[0i64; 4]; 4];
            let mut b = [0i64; 4];
            for (k, row) in rows.iter().enumerate() {
                let mut row = *row;
                row[k % 4] += 9000; // well conditioned
                let y: i64 = row.iter().zip(&x).map(|(r, x)| r * x).sum();
                for i in 0..4 {
                    for j in 0..4 {
                        a[i][j] += row[i] * row[j];
                    }
                    b[i] += row[i] * y;
                }
            }
            let got = solve(&a, &b, 4, 16).unwrap();
            prop_assert!(got.iter().zip(&x).all(|(g, x)| (g - (x << 16)).abs() <= 2), "{got:?} {x:?}");
        }

        #[test]
        fn never_overflows(rows in proptest::array::uniform3(proptest::array::uniform4(-(1i64 << 22)..1 << 22))) {
            // Normal equations of extreme rows; the last column is the right side.
            let sum = |i: usize, j: usize| rows.iter().map(|row| row[i] * row[j]).sum::<i64>();
            let a = core::array::from_fn(|i| core::array::from_fn(|j| sum(i, j)));
            let _ = solve::<3>(&a, &core::array::from_fn(|i| sum(i, 3)), 3, 32);
        }
    }

    #[test]
    fn a_singular_matrix_has_no_solution() {
        assert_eq!(solve(&[[1, 1], [1, 1]], &[1, 2], 2, 8), None);
        assert_eq!(solve(&[[4, 1], [1, 1]], &[1, 2], 1, 8), Some([64, 0]));
        assert_eq!(solve(&[[0; 2]; 2], &[0; 2], 0, 8), Some([0, 0]));
    }
}
