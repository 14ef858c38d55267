//! A background picture: grey levels, what kind of view it is, and where its sky is.

use std::vec;
use std::vec::Vec;

/// Side of a cell of the sky map, pixels.
const CELL: usize = 8;

/// Largest mean difference between neighbouring pixels in a cell of sky, grey levels.
const SMOOTH: u32 = 5;

/// Kind of view of a picture.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum PictureKind {
    /// A photograph with the horizon in it.
    Level,
    /// A photograph taken downwards at an angle: the horizon is above its upper edge, or there is hardly any sky.
    Oblique,
    /// A photograph taken straight down.
    Nadir,
    /// A panorama of 360 by 180 degrees, equirectangular.
    Panorama,
}

/// A background picture.
#[derive(Debug, Clone)]
pub(super) struct BackgroundPicture {
    pub width: usize,
    pub height: usize,
    pub pixels: Vec<u8>,
    pub kind: PictureKind,
    /// Row of the horizon.
    pub horizon: f64,
    /// Whether each cell is sky, row by row.
    sky: Vec<bool>,
}

impl BackgroundPicture {
    /// Analyses a picture; `kind` as an index says, else by its shape and sky.
    pub(super) fn new(
        pixels: Vec<u8>,
        width: usize,
        height: usize,
        kind: Option<PictureKind>,
    ) -> Self {
        let kind = kind.unwrap_or(if width == 2 * height {
            PictureKind::Panorama
        } else {
            PictureKind::Level
        });
        let mut picture = Self { width, height, pixels, kind, horizon: 0.0, sky: Vec::new() };
        picture.sky = match kind {
            PictureKind::Nadir => vec![false; (width / CELL) * (height / CELL)],
            _ => picture.find_sky(),
        };
        let rows = height as f64;
        picture.horizon = match kind {
            PictureKind::Level => {
                // The skyline's lower quarter: hills and trees stand above the horizon.
                let mut ends = picture.skyline();
                ends.sort_unstable();
                let end = ends.get(ends.len() * 3 / 4).copied().unwrap_or(0) as f64;
                end.clamp(0.25 * rows, 0.7 * rows)
            }
            PictureKind::Oblique => -0.25 * rows,
            PictureKind::Nadir => -1e6,
            PictureKind::Panorama => 0.5 * rows,
        };
        picture
    }

    /// Whether the pixel at (x, y) lies in a cell of sky; outside as at the nearest pixel.
    pub(super) fn is_sky(&self, x: usize, y: usize) -> bool {
        let columns = self.width / CELL;
        let rows = self.height / CELL;
        if columns == 0 || rows == 0 {
            return false;
        }
        self.sky[(y / CELL).min(rows - 1) * columns + (x / CELL).min(columns - 1)]
    }

    /// Rows of sky from the top in each column of cells, pixels.
    fn skyline(&self) -> Vec<usize> {
        let (columns, rows) = (self.width / CELL, self.height / CELL);
        let end = |column| (0..rows).take_while(|row| self.sky[row * columns + column]).count();
        (0..columns).map(|column| CELL * end(column)).collect()
    }

    /// Smooth cells that are connected with the upper edge.
    fn find_sky(&self) -> Vec<bool> {
        let (columns, rows) = (self.width / CELL, self.height / CELL);
        let smooth: Vec<bool> = (0..columns * rows)
            .map(|i| self.roughness(i % columns, i / columns) <= SMOOTH * 32)
            .collect();
        let mut sky = vec![false; columns * rows];
        let mut open: Vec<usize> = (0..columns).filter(|&i| smooth.get(i) == Some(&true)).collect();
        while let Some(cell) = open.pop() {
            if core::mem::replace(&mut sky[cell], true) {
                continue;
            }
            let (x, y) = (cell % columns, cell / columns);
            // Never upwards: smooth walls below a skyline stay ground. Panoramas: not below the horizon.
            let lowest = if self.kind == PictureKind::Panorama { rows / 2 } else { rows };
            let next = [
                (x > 0).then(|| cell - 1),
                (x + 1 < columns).then(|| cell + 1),
                (y + 1 < lowest).then(|| cell + columns),
            ];
            open.extend(next.into_iter().flatten().filter(|&next| smooth[next] && !sky[next]));
        }
        sky
    }

    /// Sum of the differences between neighbours over a cell, in 1/32 of a grey level in the mean of 64 pixels x 2.
    fn roughness(&self, column: usize, row: usize) -> u32 {
        let mut sum = 0;
        for y in row * CELL..(row + 1) * CELL {
            for x in column * CELL..(column + 1) * CELL {
                let at = |x: usize, y: usize| {
                    self.pixels[y.min(self.height - 1) * self.width + x.min(self.width - 1)]
                };
                sum += u32::from(at(x, y).abs_diff(at(x + 1, y)))
                    + u32::from(at(x, y).abs_diff(at(x, y + 1)));
            }
        }
        sum / 2
    }
}
