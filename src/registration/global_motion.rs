//! Global motion between two frames, and its robust fit to the shifts of corners.
//!
//! Far background seen by a turning camera moves, to first order, by quadratic polynomials with eight parameters
//! (Longuet-Higgins & Prazdny 1980; "planar motion"), which need no division for a point and are linear in the
//! parameters.

use crate::math::linear;

/// Most samples of a fit.
pub(crate) const MAX_SAMPLES: usize = 300;

/// Rounds of reweighting in a fit.
const FIT_ROUNDS: usize = 6;

/// A point this far from the fitted motion (or less) is never an outlier, in pixels, Q8.
const MIN_THRESHOLD: i64 = 256;

/// Fewest corners that agree in a valid motion.
pub(crate) const MIN_INLIERS: usize = 10;

/// Largest median residual of the corners in a valid motion, in pixels, Q8.
const MAX_MEDIAN: i64 = 3 << 7;

/// Least mean improvement over no motion for a motion to be used, in pixels, Q8.
const STILLNESS: i64 = 8;

/// Weight of the prior that all parameters but the translation are 0: a 16th of a corner at distance 1, in the units
/// of the normal equations (Q32). It decides where the corners do not reach.
const PRIOR: i64 = 1 << 28;

/// A motion of the whole picture: maps a point of a frame to where it was in the frame before.
///
/// ```
/// use lookout::registration::GlobalMotion;
///
/// // The background was 2 px further right in the frame before: parameter a, Q16.
/// let motion = GlobalMotion::new(640, 480, [2 << 16, 0, 0, 0, 0, 0, 0, 0]);
/// // Points are in Q8.
/// assert_eq!(motion.map(100 << 8, 50 << 8), (102 << 8, 50 << 8));
/// assert!(!GlobalMotion::IDENTITY.is_valid());
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct GlobalMotion {
    /// Of the polynomials in [`GlobalMotion::shift`], in pixels, Q16.
    parameters: [i32; 8],
    /// Middle of the frame, in half pixels.
    centre: (i32, i32),
    /// Logarithm to base 2 of the length that the polynomials count as 1, in pixels.
    scale: u32,
    valid: bool,
}

impl Default for GlobalMotion {
    fn default() -> Self {
        Self::IDENTITY
    }
}

impl GlobalMotion {
    /// No motion, not measured.
    pub const IDENTITY: Self = Self { parameters: [0; 8], centre: (0, 0), scale: 0, valid: false };

    /// No motion, for frames of this size.
    pub(crate) fn still(width: usize, height: usize) -> Self {
        let scale = width.max(height).next_power_of_two().ilog2().saturating_sub(1);
        Self { parameters: [0; 8], centre: (width as i32, height as i32), scale, valid: false }
    }

    /// The same, not measured, with a shift of whole pixels of a picture halved `octave` times.
    pub(crate) fn shifted(self, (x, y): (i32, i32), octave: u32) -> Self {
        let [_, _, rest @ ..] = self.parameters;
        let [b, c, e, f, g, h] = rest;
        Self { parameters: [x << (16 + octave), y << (16 + octave), b, c, e, f, g, h], ..self }
    }

    /// A measured motion of frames of this size: eight parameters as [`GlobalMotion::parameters`] gives them, each brought to
    /// at most 2^26 in magnitude.
    pub fn new(width: usize, height: usize, parameters: [i32; 8]) -> Self {
        let parameters = parameters.map(|v| v.clamp(-1 << 26, 1 << 26));
        Self { parameters, valid: true, ..Self::still(width, height) }
    }

    /// Eight parameters in pixels, Q16, in the order a d b c e f g h. At (x, y) from the middle of the frame, in lengths of
    /// half its longer side (that rounded up to a power of two), a point is shifted towards the frame before by
    /// `a + b x + c y + (g x + h y) x` to the right and `d + e x + f y + (g x + h y) y` downwards.
    pub const fn parameters(&self) -> [i32; 8] {
        self.parameters
    }

    /// Whether the background held enough to measure the motion; if not, it is the identity.
    pub const fn is_valid(&self) -> bool {
        self.valid
    }

    /// Whether every point stays where it is.
    pub fn is_identity(&self) -> bool {
        self.parameters == [0; 8]
    }

    /// Where the point (x, y) of the frame was in the frame before, both in pixels, Q8.
    pub fn map(&self, x: i32, y: i32) -> (i32, i32) {
        let (dx, dy) = self.shift(x, y);
        (x.saturating_add(dx), y.saturating_add(dy))
    }

    /// Shift of the point (x, y) towards the frame before, all in pixels, Q8.
    pub(crate) fn shift(&self, x: i32, y: i32) -> (i32, i32) {
        let (x, y) = self.normalised(x, y);
        let [a, d, b, c, e, f, g, h] = self.parameters.map(i64::from);
        let bent = g * x + h * y;
        let along = |p: i64, q: i64, r: i64, v: i64| {
            let slope = q * x + r * y + (bent >> 16) * v;
            ((p + (slope >> 16) + 128) >> 8) as i32
        };
        (along(a, b, c, x), along(d, e, f, y))
    }

    /// The point relative to the middle of the frame, Q16; points far outside are brought nearer.
    fn normalised(&self, x: i32, y: i32) -> (i64, i64) {
        let relative = |v: i32, centre: i32| {
            let v = (i64::from(v) - (i64::from(centre) << 7)) << 8 >> self.scale;
            v.clamp(-1 << 18, 1 << 18)
        };
        (relative(x, self.centre.0), relative(y, self.centre.1))
    }
}

/// A corner of the new frame and its shift towards the last one, in pixels of the frame, Q8.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct CornerShift {
    pub(crate) x: i32,
    pub(crate) y: i32,
    pub(crate) dx: i32,
    pub(crate) dy: i32,
}

/// Robust fit of a motion with up to `unknowns` parameters: iteratively reweighted least squares with Tukey's biweight,
/// whose threshold is three times the median distance of each round. Starts from the median shift.
#[inline(never)]
pub(crate) fn fit(still: GlobalMotion, samples: &[CornerShift], unknowns: usize) -> GlobalMotion {
    if samples.len() < MIN_INLIERS {
        return still;
    }
    let mut motion = still;
    motion.parameters[0] = median(samples.iter().map(|s| s.dx)) * 256;
    motion.parameters[1] = median(samples.iter().map(|s| s.dy)) * 256;
    let mut far = distances(&motion, samples);
    let mut threshold = spread(&far);
    for round in 0..FIT_ROUNDS {
        let unknowns = if round < 2 { unknowns.min(6) } else { unknowns };
        let Some(better) = weighted_fit(&motion, samples, &far, unknowns, threshold) else {
            return still;
        };
        motion = better;
        far = distances(&motion, samples);
        threshold = spread(&far);
    }
    let inliers = far.iter().filter(|&&distance| i64::from(distance) < threshold).count();
    let valid = inliers >= MIN_INLIERS && threshold <= 3 * MAX_MEDIAN;
    // A camera on a tripod: a motion fitted to the noise of few corners extrapolates badly.
    let count = samples.len() as i64;
    let unmoved = misfit(&distances(&still, samples));
    if unmoved <= misfit(&far) * 9 / 8 + count * STILLNESS {
        motion = still;
    }
    GlobalMotion { valid, ..motion }
}

/// Distances of samples from a motion, in pixels, Q8: see [`distance`].
type Distances = heapless::Vec<i32, MAX_SAMPLES>;

fn distances(motion: &GlobalMotion, samples: &[CornerShift]) -> Distances {
    samples.iter().map(|sample| distance(motion, sample)).collect()
}

/// Sum of the distances, none counted above the least threshold, in pixels, Q8.
fn misfit(distances: &Distances) -> i64 {
    distances.iter().map(|&distance| i64::from(distance).min(MIN_THRESHOLD)).sum()
}

/// Distance beyond which a sample is an outlier: three times the median, in pixels, Q8.
fn spread(distances: &Distances) -> i64 {
    (3 * i64::from(median(distances.iter().copied()))).max(MIN_THRESHOLD)
}

/// Larger of the distances in x and y between a sample and where the motion puts it, in pixels, Q8.
fn distance(motion: &GlobalMotion, sample: &CornerShift) -> i32 {
    let (dx, dy) = motion.shift(sample.x, sample.y);
    (sample.dx - dx).abs().max((sample.dy - dy).abs())
}

/// Median (the upper one of two) of at least one and at most [`MAX_SAMPLES`] values.
fn median(values: impl Iterator<Item = i32>) -> i32 {
    let mut values: heapless::Vec<i32, MAX_SAMPLES> = values.collect();
    let middle = values.len() / 2;
    *values.select_nth_unstable(middle).1
}

/// One least-squares fit, samples weighted by their distances `far` from `motion`.
fn weighted_fit(
    motion: &GlobalMotion,
    samples: &[CornerShift],
    far: &Distances,
    unknowns: usize,
    threshold: i64,
) -> Option<GlobalMotion> {
    let (mut matrix, mut right) = ([[0i64; 8]; 8], [0i64; 8]);
    for (i, row) in matrix.iter_mut().enumerate().skip(2) {
        row[i] = PRIOR;
    }
    for (sample, &distance) in samples.iter().zip(far) {
        let inside = 256 - i64::from(distance).min(threshold).pow(2) * 256 / threshold.pow(2);
        let weight = (inside * inside) >> 8;
        if weight == 0 {
            continue;
        }
        let (x, y) = motion.normalised(sample.x, sample.y);
        let (x, y) = (x >> 4, y >> 4); // Q12
        let (xx, xy, yy) = ((x * x) >> 12, (x * y) >> 12, (y * y) >> 12);
        // The parameters that a component of the shift depends on, and how much.
        let across = [(0, 4096), (2, x), (3, y), (6, xx), (7, xy)];
        let down = [(1, 4096), (4, x), (5, y), (6, xy), (7, yy)];
        for (row, shift) in [(across, sample.dx), (down, sample.dy)] {
            for (n, &(i, factor)) in row.iter().enumerate().take_while(|(_, (i, _))| *i < unknowns)
            {
                let weighted = weight * factor;
                for &(j, other) in &row[n..] {
                    matrix[i % 8][j % 8] += weighted * other;
                }
                right[i % 8] += weighted * i64::from(shift);
            }
        }
    }
    // Rows are Q12, shifts Q8, parameters Q16.
    let solution = linear::solve(&matrix, &right, unknowns, 20)?;
    Some(GlobalMotion {
        parameters: solution.map(|v| v.clamp(-1 << 26, 1 << 26) as i32),
        ..*motion
    })
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::vec::Vec;

    /// Largest distance over the frame between a motion and the true one, in pixels.
    pub(crate) fn error(
        w: usize,
        h: usize,
        motion: &GlobalMotion,
        truth: impl Fn(f64, f64) -> (f64, f64),
    ) -> f64 {
        let mut worst = 0f64;
        for (x, y) in (0..=8).flat_map(|j| (0..=8).map(move |i| (w * i / 8, h * j / 8))) {
            let (gx, gy) = motion.map((x << 8) as i32, (y << 8) as i32);
            let (tx, ty) = truth(x as f64, y as f64);
            worst = worst.max((f64::from(gx) / 256.0 - tx).hypot(f64::from(gy) / 256.0 - ty));
        }
        worst
    }

    proptest! {
        #[test]
        fn one_fit_agrees_with_f64(parameters in proptest::array::uniform8(-8.0..8.0f64), jitter in proptest::collection::vec((0..640i32, 0..480i32, -400..400i32, -400..400i32), 30..200)) {
            let still = GlobalMotion::still(640, 480);
            let basis = |x: i32, y: i32| {
                let (x, y) = ((f64::from(x) - 320.0) / 512.0, (f64::from(y) - 240.0) / 512.0);
                [[1.0, 0.0, x, y, 0.0, 0.0, x * x, x * y], [0.0, 1.0, 0.0, 0.0, x, y, x * y, y * y]]
            };
            let dot = |a: [f64; 8], b: [f64; 8]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
            let samples: Vec<CornerShift> = jitter.iter().map(|&(x, y, jx, jy)| {
                let [dx, dy] = basis(x, y).map(|row| (dot(row, parameters) * 256.0) as i32);
                CornerShift { x: x << 8, y: y << 8, dx: dx + jx, dy: dy + jy }
            }).collect();
            let threshold = 12 << 8;
            let got = weighted_fit(&still, &samples, &distances(&still, &samples), 8, threshold).unwrap();

            let mut system = [[0.0; 9]; 8];
            for (i, row) in system.iter_mut().enumerate().skip(2) {
                row[i] = 1.0 / 16.0;
            }
            for s in &samples {
                let r = f64::from(s.dx.abs().max(s.dy.abs())) / 256.0;
                let weight = (1.0 - (r / 12.0).min(1.0).powi(2)).powi(2);
                for (row, shift) in basis(s.x >> 8, s.y >> 8).iter().zip([s.dx, s.dy]) {
                    for i in 0..8 {
                        for j in 0..8 {
                            system[i][j] += weight * row[i] * row[j];
                        }
                        system[i][8] += weight * row[i] * f64::from(shift) / 256.0;
                    }
                }
            }
            prop_assume!(system[0][0] > 10.0);
            for k in 0..8 {
                for i in (0..8).filter(|&i| i != k) {
                    let (factor, pivot) = (system[i][k] / system[k][k], system[k]);
                    system[i].iter_mut().zip(pivot).for_each(|(v, p)| *v -= factor * p);
                }
            }
            let want: [f64; 8] = core::array::from_fn(|k| system[k][8] / system[k][k]);
            let truth = |x: f64, y: f64| {
                let [dx, dy] = basis(x as i32, y as i32).map(|row| dot(row, want));
                (x + dx, y + dy)
            };
            prop_assert!(error(640, 480, &got, truth) < 0.1);
        }
    }
}
