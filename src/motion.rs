//! Algorithm 1: regressors keep the object in the middle of every slice (level 5).
//!
//! For each slice, from the newest back in time: cut the patch, let φ_h and φ_v say from its HoG how far the object is
//! from the middle, move the patch there, and repeat while the last move was longer than ε and fewer than n_max moves
//! were made. (The paper prints the loop's test the wrong way round; without n_max it need not end.) An older slice
//! starts where the background's motion puts the object's last place, so that what is left to find is the object's
//! motion against the background.

use crate::cube::{Cube, Patch, SCALARS, SLICES, SUBCELL, WINDOW};
use crate::feature::Features;
use crate::gradient::CELL;
use crate::integral::Integral;
use crate::registration::Motion;
use crate::trees::Forest;

/// Fraction bits of what φ_h and φ_v give: cells in Q8.
pub const OFFSET_BITS: u32 = 8;

/// ε²: the loop ends when the last move was no longer, in quarters of a cell (pixels of the paper's 40x40 window).
const EPSILON_SQUARED: i32 = 1;

/// n_max: most moves of one slice.
pub const MAX_MOVES: usize = 4;

/// Farthest a slice may go from where it started, in quarters of a cell: half a window.
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

/// A position on a level: the upper left corner of a window, in quarters of a cell.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Position {
    /// To the right.
    pub x: i32,
    /// Downwards.
    pub y: i32,
}

impl Position {
    /// The window's centre in the frame, Q8 pixels, on a level whose pixels are `scale` (Q16) frame pixels.
    pub fn centre(self, scale: u32) -> (i32, i32) {
        let centre = |v: i32| {
            let middle = v + WINDOW as i32 * SUBCELL / 2;
            ((i64::from(middle) * CELL as i64 * i64::from(scale)) / (i64::from(SUBCELL) << 8))
                as i32
        };
        (centre(self.x), centre(self.y))
    }

    /// The window whose centre is nearest to a point of the frame, Q8 pixels.
    pub fn centred(point: (i32, i32), scale: u32) -> Self {
        let corner = |v: i32| {
            let unit = CELL as i64 * i64::from(scale);
            let quarters = (((i64::from(v) * i64::from(SUBCELL)) << 8) + unit / 2).div_euclid(unit);
            quarters as i32 - WINDOW as i32 * SUBCELL / 2
        };
        Self { x: corner(point.0), y: corner(point.1) }
    }
}

/// What the slices of a cube are cut from.
#[derive(Debug, Clone, Copy)]
pub struct Slices<'a> {
    /// Tables of the level, newest first; frames not yet seen repeat the oldest.
    pub tables: [Integral<'a>; SLICES],
    /// Second table of the newest frame.
    pub newest: Integral<'a>,
    /// Motion of the background from the frame k ago to the one before it.
    pub motions: [Motion; SLICES - 1],
    /// Frame pixels of a pixel of the level, Q16.
    pub scale: u32,
}

/// Where Algorithm 1 put the slices.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Path {
    /// The window in each slice, newest first.
    pub positions: [Position; SLICES],
    /// How far each slice was moved from where the background's motion had put it, quarters of a cell.
    pub moved: [Position; SLICES],
    /// Moves of all slices together.
    pub moves: u32,
}

/// First of the scalars that [`compensate`] writes: see [`Path::scalars`].
pub const FIRST_SCALAR: usize = 4;

impl Path {
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
        let mut scalars = [0; SCALARS - FIRST_SCALAR];
        scalars[0] = length(a.x, a.y);
        scalars[1] = length(b.x, b.y);
        scalars[2] = length(c.x, c.y);
        scalars[3] = length(d.x, d.y);
        scalars[4] = length(b.x - c.x, b.y - c.y);
        scalars[5] = length(c.x - d.x, c.y - d.y);
        scalars[6] = length(b.x + c.x + d.x, b.y + c.y + d.y);
        scalars[7] = self.moves as u16;
        scalars
    }
}

/// Cuts the cube of the window at `start`: with `regressors` by Algorithm 1, without them along the background alone.
pub fn compensate(
    slices: &Slices<'_>,
    regressors: Option<&Regressors<'_>>,
    start: Position,
    cube: &mut Cube,
) -> Path {
    let mut path = Path::default();
    let mut at = start;
    for k in 0..SLICES {
        if k > 0 {
            let (x, y) = at.centre(slices.scale);
            at = Position::centred(slices.motions[k - 1].map(x, y), slices.scale);
        }
        let origin = at;
        let (table, patch) = (&slices.tables[k], &mut cube.slices[k]);
        patch.cut(table, at.x, at.y);
        for _ in 0..regressors.map_or(0, |_| MAX_MOVES) {
            let Some(regressors) = regressors else { break };
            let (h, v) = regressors.offset(patch);
            // Farther than the slice may go is all the same, and leaves room for the arithmetic.
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
            if (dx, dy) == (0, 0) {
                break;
            }
            at = next;
            patch.cut(table, at.x, at.y);
            path.moves += 1;
            if dx * dx + dy * dy <= EPSILON_SQUARED {
                break;
            }
        }
        path.positions[k] = at;
        path.moved[k] = Position { x: at.x - origin.x, y: at.y - origin.y };
    }
    cube.newest.cut(&slices.newest, path.positions[0].x, path.positions[0].y);
    cube.scalars[FIRST_SCALAR..].copy_from_slice(&path.scalars());
    path
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn positions_survive_the_frame(x in -100..4000i32, y in -100..4000i32, scale in 65536..2_000_000u32) {
            let position = Position { x, y };
            prop_assert_eq!(Position::centred(position.centre(scale), scale), position);
        }
    }
}
