//! Algorithm 1 of the paper, object-centric motion compensation: regressors centre every slice on the object.
//!
//! For each slice, from the newest back in time: cut the patch, predict from its HoG the object's offset from the middle
//! (φ_h, φ_v), move the patch there, and repeat while the last move was longer than ε and fewer than n_max moves were
//! made. (The paper prints the loop's test the wrong way round; without n_max it need not end.) An older slice starts at
//! the object's last position moved with the background, so that the residual is the object's motion relative to the
//! background.

use crate::channels::front_end::Slices;
pub use crate::channels::method::Alignment;
use crate::channels::window::{Position, SLICES, SUBCELL, WINDOW};
use crate::stcube::cube::{Cube, Patch, SCALARS, Scalar};
use crate::stcube::feature::Features;
use crate::trees::Forest;

/// Fraction bits of the offsets that φ_h and φ_v predict: cells in Q8.
pub const OFFSET_BITS: u32 = 8;

/// ε²: the loop ends when the last move was no longer, in quarters of a cell (pixels of the paper's 40x40 window).
const EPSILON_SQUARED: i32 = 1;

/// n_max: most moves of one slice.
pub const MAX_MOVES: usize = 4;

/// Largest residual shift of a slice, in quarters of a cell: half a window. Predictions beyond it are clamped.
const FARTHEST: i32 = WINDOW as i32 * SUBCELL / 2;

/// φ_h and φ_v, and the features that their trees ask for.
#[derive(Debug, Clone, Copy)]
pub struct Regressors<'m> {
    /// Features of a single patch.
    pub features: Features<'m>,
    /// φ_h: the object's centre right of the patch's, Q8 cells.
    pub horizontal: Forest<'m>,
    /// φ_v: the object's centre below the patch's, Q8 cells.
    pub vertical: Forest<'m>,
}

impl Regressors<'_> {
    /// (φ_h, φ_v) of a patch: how far the object is from its middle, Q8 cells.
    pub fn offset(&self, patch: &Patch) -> (i32, i32) {
        let test = |feature, threshold| self.features.patch_exceeds(feature, threshold, patch);
        (self.horizontal.score(test), self.vertical.score(test))
    }
}

/// Trajectory of the window through the slices.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Trajectory {
    /// The window in each slice, newest first.
    pub positions: [Position; SLICES],
    /// Residual shift of each slice relative to the background's motion, quarters of a cell.
    pub moved: [Position; SLICES],
    /// Moves of all slices together.
    pub moves: u32,
    /// Moves of each slice.
    pub slice_moves: [u8; SLICES],
    /// Whether Algorithm 1 converged in a slice: its last move was no longer than ε. Otherwise n_max ended it.
    pub settled: [bool; SLICES],
}

/// First of the scalars that [`compensate`] writes: see [`Trajectory::scalars`].
pub const FIRST_SCALAR: usize = Scalar::TRAJECTORY.place();

impl Trajectory {
    /// The path as scalars of a cube: lengths of the moves of slices 0 to 3; of the changes between the moves of 1 and
    /// 2, 2 and 3; of all older moves together; number of moves.
    pub fn scalars(&self) -> [u16; SCALARS - FIRST_SCALAR] {
        let length = |x: i32, y: i32| {
            // Octagonal norm in eighths of a quarter cell, as in `gradient`.
            let (a, b) = (x.unsigned_abs(), y.unsigned_abs());
            let (long, short) = (a.max(b), a.min(b));
            (8 * long).max(7 * long + 4 * short).min(u32::from(u16::MAX)) as u16
        };
        let [a, b, c, d] = self.moved;
        let values = [
            length(a.x, a.y),
            length(b.x, b.y),
            length(c.x, c.y),
            length(d.x, d.y),
            length(b.x - c.x, b.y - c.y),
            length(c.x - d.x, c.y - d.y),
            length(b.x + c.x + d.x, b.y + c.y + d.y),
            self.moves as u16,
        ];
        core::array::from_fn(|place| values.get(place).copied().unwrap_or(0))
    }
}

/// Cuts the cube of the window at `start`: with `regressors` by Algorithm 1, without them along the background alone.
pub fn compensate(
    slices: &Slices<'_>,
    regressors: Option<&Regressors<'_>>,
    start: Position,
    cube: &mut Cube,
) -> Trajectory {
    let mut path = Trajectory::default();
    let mut at = start;
    for k in 0..SLICES {
        if k > 0 {
            let (x, y) = at.centre(slices.scale);
            at = Position::centred(slices.motions[k - 1].map(x, y), slices.scale);
        }
        let (origin, before) = (at, path.moves);
        let patch = &mut cube.slices[k];
        let Some(slice) = &slices.slices[k] else {
            patch.clear();
            path.positions[k] = at;
            continue;
        };
        patch.cut(slice, at.x, at.y);
        for _ in 0..regressors.map_or(0, |_| MAX_MOVES) {
            let Some(regressors) = regressors else { break };
            let (h, v) = regressors.offset(patch);
            // Clamped before the arithmetic, which would overflow.
            let quarters = |offset: i32| {
                let offset = offset.clamp(-(FARTHEST << OFFSET_BITS), FARTHEST << OFFSET_BITS);
                (offset * SUBCELL + (1 << (OFFSET_BITS - 1))) >> OFFSET_BITS
            };
            let bound = |v: i32, origin: i32| v.clamp(origin - FARTHEST, origin + FARTHEST);
            let next = Position {
                x: bound(at.x + quarters(h), origin.x),
                y: bound(at.y + quarters(v), origin.y),
            };
            let (dx, dy) = (next.x - at.x, next.y - at.y);
            if (dx, dy) != (0, 0) {
                at = next;
                patch.cut(slice, at.x, at.y);
                path.moves += 1;
            }
            if dx * dx + dy * dy <= EPSILON_SQUARED {
                path.settled[k] = true;
                break;
            }
        }
        path.slice_moves[k] = (path.moves - before) as u8;
        path.positions[k] = at;
        path.moved[k] = Position { x: at.x - origin.x, y: at.y - origin.y };
    }
    cube.newest.cut_newest(&slices.newest, path.positions[0].x, path.positions[0].y);
    cube.scalars[FIRST_SCALAR..].copy_from_slice(&path.scalars());
    path
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::channels::{Difference, MAGNITUDE, NewestChannels, Slice};
    use crate::image::Image;
    use crate::registration::GlobalMotion;
    use crate::registration::global_motion::{CornerShift, fit};
    use crate::stcube::cube::Region;
    use crate::stcube::feature::{Denominator, Feature};
    use crate::trees::{NEVER_REJECT, Node, encode};
    use proptest::prelude::*;
    use std::vec;
    use std::vec::Vec;

    /// Cells in a row and in a column of the level.
    const SIDE: usize = 40;

    /// Pixels of a level on which cell (x, y) is `value(x, y)` before black: every second one each way, so that the
    /// cell's magnitude is proportional to it.
    fn picture(value: impl Fn(i32, i32) -> u8) -> Vec<u8> {
        let side = 2 * SIDE as i32;
        (0..side * side)
            .map(|i| {
                if i % 2 == 0 && i / side % 2 == 0 { value(i % side / 2, i / side / 2) } else { 0 }
            })
            .collect()
    }

    /// The background moves by (dx, dy) pixels, Q8.
    fn translation(dx: i32, dy: i32) -> GlobalMotion {
        let samples: Vec<CornerShift> =
            (0..100).map(|i| CornerShift { x: i % 10 * 2000, y: i / 10 * 2000, dx, dy }).collect();
        let motion = fit(GlobalMotion::still(80, 80), &samples, 2);
        assert_eq!(motion.map(9000, 3000), (9000 + dx, 3000 + dy));
        motion
    }

    fn slices(pictures: &[Vec<u8>], motions: [GlobalMotion; SLICES - 1], scale: u32) -> Slices<'_> {
        let view = |i: usize| {
            let pixels = &pictures[i.min(pictures.len() - 1)];
            let picture = Image::packed(pixels, 2 * SIDE, 2 * SIDE).unwrap();
            Slice { grey: picture, near: Difference { picture, halved: false } }
        };
        let newest = NewestChannels {
            slice: view(0),
            far: view(0).near,
            plain: view(0).near,
            oriented: true,
        };
        Slices { slices: core::array::from_fn(|i| Some(view(i))), newest, motions, scale }
    }

    fn empty() -> Cube {
        Cube::EMPTY
    }

    /// Magnitude of the left, right, upper and lower half of a patch against that of the whole.
    fn halves() -> Vec<u8> {
        let half = |x, y| Feature {
            denominator: Denominator::Window,
            channel: MAGNITUDE as u8,
            x,
            y,
            t: (0, 1),
        };
        let (all, first, second) = ((0, 10), (0, 5), (5, 10));
        [half(first, all), half(second, all), half(all, first), half(all, second)]
            .iter()
            .flat_map(Feature::encode)
            .collect()
    }

    /// Calls `with` with regressors of these features and forests.
    fn regressors<T>(
        features: &[u8],
        forests: [&[u8]; 2],
        with: impl Fn(&Regressors<'_>) -> T,
    ) -> T {
        let [horizontal, vertical] = forests.map(|bytes| Forest::parse(bytes).unwrap().0);
        with(&Regressors { features: Features::parse(features).unwrap(), horizontal, vertical })
    }

    /// Algorithm 1 as the paper has it, with the loop's test the right way round: position and moves of one slice.
    fn textbook(
        regressors: &Regressors<'_>,
        slice: &Slice<'_>,
        start: Position,
    ) -> (Position, u32) {
        let (mut at, mut n, mut moves) = (start, 0, 0);
        loop {
            let mut patch = Patch::EMPTY;
            patch.cut(slice, at.x, at.y);
            let (h, v) = regressors.offset(&patch);
            // To whole quarters of a cell, no farther than half a window from the start.
            let step = |offset: i32| (f64::from(offset) / 64.0 + 0.5).floor() as i32;
            let x = (at.x + step(h)).clamp(start.x - 20, start.x + 20);
            let y = (at.y + step(v)).clamp(start.y - 20, start.y + 20);
            let length = f64::from(x - at.x).hypot(f64::from(y - at.y));
            at = Position { x, y };
            n += 1;
            moves += u32::from(length > 0.0);
            if !(length > 1.0 && n < 4) {
                return (at, moves);
            }
        }
    }

    fn tree() -> impl Strategy<Value = (i32, Vec<Node>, Vec<i16>)> {
        let node =
            (0..4u16, 300..700u16).prop_map(|(feature, threshold)| Node { feature, threshold });
        let leaves = prop::collection::vec(-400..400i16, 4);
        (Just(NEVER_REJECT), prop::collection::vec(node, 3), leaves)
    }

    prop_compose! {
        fn forest()(bias in -100..100i32, trees in prop::collection::vec(tree(), 0..4)) -> Vec<u8> {
            encode(2, bias, 4, &trees)
        }
    }

    proptest! {
        #[test]
        fn agrees_with_the_textbook(
            horizontal in forest(), vertical in forest(), start_x in -12..140i32, start_y in -12..140i32,
            shifts in prop::array::uniform3((-4000..4000i32, -4000..4000i32)), scale in 65536..500_000u32,
            seed in any::<u32>(),
        ) {
            let texture = |k: usize| picture(move |x, y| {
                let n = (x as u32 / 3).wrapping_mul(0x9e37_79b1) ^ (y as u32 / 2).wrapping_mul(0x85eb_ca77);
                ((n ^ seed).wrapping_mul(0x2c1b_3c6d + 2 * k as u32) >> 24) as u8
            });
            let pictures: Vec<_> = (0..SLICES).map(texture).collect();
            let slices = slices(&pictures, shifts.map(|(dx, dy)| translation(dx, dy)), scale);
            let mut cube = empty();
            let start = Position { x: start_x, y: start_y };
            regressors(&halves(), [&horizontal, &vertical], |regressors| {
                let path = compensate(&slices, Some(regressors), start, &mut cube.clone());
                let (mut origin, mut moves) = (start, 0);
                for k in 0..SLICES {
                    if let Some(older) = k.checked_sub(1) {
                        // Where the background took the last slice's centre.
                        let last = path.positions[older];
                        let quarter = f64::from(scale) / 65536.0 / 2.0;
                        let place = |at: i32, shift: i32| {
                            f64::from(at) + f64::from(shift) / 256.0 / quarter
                        };
                        let (dx, dy) = shifts[older];
                        let exact = (place(last.x, dx), place(last.y, dy));
                        let moved = path.moved[k];
                        let at = path.positions[k];
                        origin = Position { x: at.x - moved.x, y: at.y - moved.y };
                        prop_assert!((f64::from(origin.x) - exact.0).abs() <= 0.51, "{:?} {:?}", origin, exact);
                        prop_assert!((f64::from(origin.y) - exact.1).abs() <= 0.51, "{:?} {:?}", origin, exact);
                    }
                    let (at, n) = textbook(regressors, &slices.slices[k].unwrap(), origin);
                    moves += n;
                    prop_assert_eq!(path.positions[k], at);
                }
                prop_assert_eq!(path.moves, moves);
                Ok(())
            })?;
            cube.scalars = [9; SCALARS];
            let path = compensate(&slices, None, start, &mut cube);
            prop_assert_eq!(path.moved, [Position::default(); SLICES]);
            prop_assert_eq!(cube.scalars[..FIRST_SCALAR].to_vec(), vec![9; FIRST_SCALAR]);
        }
    }

    #[test]
    fn moves_end_at_epsilon_and_n_max() {
        let pictures = [picture(|_, _| 50)];
        let slices = slices(&pictures, [GlobalMotion::IDENTITY; SLICES - 1], 65536);
        let push = |horizontal: i32, vertical: i32| {
            let forests = [horizontal, vertical].map(|bias| encode(1, bias, 4, &[]));
            regressors(&halves(), [&forests[0], &forests[1]], |regressors| {
                compensate(&slices, Some(regressors), Position { x: 40, y: 40 }, &mut empty())
            })
        };
        // Per slice, quarters of a cell: nothing; one move of ε; of more than ε, until n_max; as far as it may go.
        let cases = [
            (0, 0, 0, 0, 0),
            (64, 0, 1, 0, 1),
            (64, -64, 4, -4, 4),
            (256, 0, 16, 0, 4),
            (-384, 0, -20, 0, 4),
        ];
        for (horizontal, vertical, x, y, moves) in cases {
            let path = push(horizontal, vertical);
            assert_eq!(path.moved, [Position { x, y }; SLICES], "{horizontal} {vertical}");
            assert_eq!(path.moves, 4 * moves, "{horizontal} {vertical}");
            assert_eq!(path.slice_moves, [moves as u8; SLICES], "{horizontal} {vertical}");
            assert_eq!(path.settled, [moves < 4; SLICES], "{horizontal} {vertical}");
        }
        // A regressor gone mad does no more than go as far as it may.
        let path = push(i32::MAX, i32::MIN);
        assert_eq!(path.moved, [Position { x: 20, y: -20 }; SLICES]);
    }

    #[test]
    fn older_slices_start_where_the_background_was() {
        let pictures = [picture(|x, y| (x * y) as u8)];
        // 3, -2 and 0 pixels a frame: 6, -4 and 0 quarters of a cell of two pixels.
        let motions = [translation(768, 0), translation(-512, 256), translation(0, 0)];
        let slices = slices(&pictures, motions, 65536);
        let path = compensate(&slices, None, Position { x: 41, y: 22 }, &mut empty());
        let expected = [(41, 22), (47, 22), (43, 24), (43, 24)].map(|(x, y)| Position { x, y });
        assert_eq!(path.positions, expected);
        assert_eq!((path.moved, path.moves), ([Position::default(); SLICES], 0));
    }

    #[test]
    fn slices_that_are_not_there_stay_empty_and_on_the_background() {
        let pictures = [picture(|x, y| (x * y) as u8)];
        let mut slices = slices(&pictures, [translation(768, 0); SLICES - 1], 65536);
        let all = compensate(&slices, None, Position { x: 40, y: 40 }, &mut empty());
        slices.slices[1..].fill(None);
        let mut cube = empty();
        cube.slices[2].cut(&slices.slices[0].unwrap(), 40, 40);
        assert_eq!(compensate(&slices, None, Position { x: 40, y: 40 }, &mut cube), all);
        let energy = |k: usize| cube.slices[k].sum(MAGNITUDE, &Region::WHOLE);
        assert!(energy(0) > 0 && (1..SLICES).all(|k| energy(k) == 0));
    }

    #[test]
    fn the_object_stays_in_the_middle() {
        // A square of 4 cells that flies 2 cells to the right and 1 up a frame before a still background.
        let corner = |k: i32| (20 - 2 * k, 14 + k);
        let pictures: Vec<_> = (0..SLICES as i32)
            .map(|k| {
                let (left, top) = corner(k);
                picture(move |x, y| {
                    200 * u8::from((left..left + 4).contains(&x) && (top..top + 4).contains(&y))
                })
            })
            .collect();
        let slices = slices(&pictures, [GlobalMotion::IDENTITY; SLICES - 1], 65536);
        // To where more than the half is.
        let towards = |feature: u16| {
            let node = |threshold| Node { feature, threshold };
            encode(
                2,
                0,
                4,
                &[(NEVER_REJECT, vec![node(510), node(300), node(720)], vec![-400, -64, 64, 400])],
            )
        };
        let path = regressors(&halves(), [&towards(1), &towards(3)], |regressors| {
            compensate(&slices, Some(regressors), Position { x: 4 * 18, y: 4 * 10 }, &mut empty())
        });
        for (k, at) in path.positions.iter().enumerate() {
            let (left, top) = corner(k as i32);
            let (x, y) = (4 * (left + 2 - 5), 4 * (top + 2 - 5));
            assert!((at.x - x).abs() <= 4 && (at.y - y).abs() <= 4, "{k}: {at:?}, not {x} {y}");
        }
    }

    #[test]
    fn the_path_is_told_in_scalars() {
        let moved = [(1, 0), (3, -4), (0, 0), (-20, 20)].map(|(x, y)| Position { x, y });
        let path = Trajectory { moved, moves: 7, ..Trajectory::default() };
        // Eighths: max(8 long, 7 long + 4 short).
        assert_eq!(path.scalars()[..8], [8, 40, 0, 220, 40, 220, 183, 7]);
    }

    proptest! {
        #[test]
        fn positions_survive_the_frame(x in -100..4000i32, y in -100..4000i32, scale in 65536..2_000_000u32) {
            let position = Position { x, y };
            prop_assert_eq!(Position::centred(position.centre(scale), scale), position);
        }
    }
}
