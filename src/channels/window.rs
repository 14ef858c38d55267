//! Windows of the scan and of st-cubes: their constants, and conversions between cells, quarters of a cell and pixels of
//! the frame.

use crate::image::Rect;
use crate::image::gradient::CELL;
use fixed::types::I28F4;

/// Cells along one side of a window.
pub const WINDOW: usize = 10;

/// Slices of a st-cube, s_t of the paper (section 3).
pub const SLICES: usize = 4;

/// Positions of a window for each cell (Q2).
pub const SUBCELL: i32 = 4;

/// Cells of the map around the picture, so that windows may hang over its edge.
pub const PADDING: usize = 3;

/// A position on a level: the upper left corner of a window, in quarters of a cell.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Position {
    /// Column of the corner, quarters of a cell to the right.
    pub x: i32,
    /// Row of the corner, quarters of a cell downwards.
    pub y: i32,
}

impl Position {
    /// Window whose upper left corner is that of cell (x, y).
    pub fn of_cell(x: i16, y: i16) -> Self {
        Self { x: i32::from(x) * SUBCELL, y: i32::from(y) * SUBCELL }
    }

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

/// Box of a size (Q4 pixels) around a centre (Q8 pixels).
pub fn boxed(centre: (i32, i32), width: i32, height: i32) -> Rect {
    Rect {
        x: I28F4::from_bits((centre.0 >> 4) - width / 2),
        y: I28F4::from_bits((centre.1 >> 4) - height / 2),
        width: I28F4::from_bits(width),
        height: I28F4::from_bits(height),
    }
}

/// Centre of a box, Q8 pixels.
pub fn centre(rect: &Rect) -> (i32, i32) {
    let middle = |from: I28F4, length: I28F4| (from.to_bits() << 4) + (length.to_bits() << 3);
    (middle(rect.x, rect.width), middle(rect.y, rect.height))
}
