//! Motion of a place of the world in the picture, from the camera's attitude or from the background's measured motion.

use super::course::PasteCourse;
use super::turning::Turning;
use super::{FRAME, FramePoint};
use crate::registration::GlobalMotion;
use std::sync::Arc;
use std::vec;
use std::vec::Vec;

/// Focal length of a camera of which nothing is known, in widths of the frame: 60 degrees across.
const FOCAL: f64 = 0.87;

/// Source of the motion of pasted objects before the world.
#[derive(Debug, Clone)]
pub enum Anchor {
    /// The attitude of the camera in each frame.
    Attitude(Arc<Turning>),
    /// The background's motion from each frame to the one before, from [`crate::registration::measure`].
    Motion(Arc<Vec<GlobalMotion>>),
}

impl Anchor {
    /// Where an object on `course` is in each of the frames `first..first + count` (from 0) of frames of `size`, if it is
    /// at `place` in frame `index` of the clip; none where it is behind the camera.
    pub(super) fn places(
        &self,
        course: PasteCourse,
        (first, count): (usize, usize),
        (index, place): (usize, FramePoint),
        size: (usize, usize),
    ) -> Option<Vec<Option<FramePoint>>> {
        let time = |index: usize| (index - first) as f64 * FRAME;
        match self {
            Self::Attitude(turning) => {
                let bearing = turning.bearing(index + 1, place)?;
                let course = course.through(bearing, time(index));
                let at = |index: usize| turning.place(index + 1, course.bearing(time(index)));
                Some((first..first + count).map(at).collect())
            }
            Self::Motion(motions) => {
                let focal = FOCAL * size.0 as f64;
                let bearing = |index: usize| course.bearing(time(index));
                let own = |from: usize, to: usize| {
                    [0, 1].map(|i| focal * (bearing(to)[i] - bearing(from)[i]))
                };
                let mut places = vec![None; count];
                places[index - first] = Some(place);
                let mut at = place;
                for frame in index + 1..first + count {
                    let moved = forward(motions.get(frame), at);
                    let own = own(frame - 1, frame);
                    at = [moved[0] + own[0], moved[1] + own[1]];
                    places[frame - first] = Some(at);
                }
                at = place;
                for frame in (first..index).rev() {
                    let own = own(frame, frame + 1);
                    at = backward(motions.get(frame + 1), [at[0] - own[0], at[1] - own[1]]);
                    places[frame - first] = Some(at);
                }
                Some(places)
            }
        }
    }
}

/// Where a point of a frame was in the frame before.
fn backward(motion: Option<&GlobalMotion>, place: FramePoint) -> FramePoint {
    let [x, y] = place.map(|v| (v * 256.0).round().clamp(-1e8, 1e8) as i32);
    let (x, y) = motion.map_or((x, y), |motion| motion.map(x, y));
    [x, y].map(|v| f64::from(v) / 256.0)
}

/// Where a point of the frame before is in a frame: the inverse of [`backward`], by fixed-point iteration.
fn forward(motion: Option<&GlobalMotion>, place: FramePoint) -> FramePoint {
    let mut guess = place;
    for _ in 0..8 {
        let back = backward(motion, guess);
        guess = [0, 1].map(|i| guess[i] + place[i] - back[i]);
    }
    guess
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::shell::support::random::Random;

    /// A camera that turns right and about its axis, and comes nearer.
    fn motions() -> Anchor {
        let motion = GlobalMotion::new(
            320,
            240,
            [400_000, -90_000, 60_000, -40_000, 40_000, 60_000, 900, 0],
        );
        Anchor::Motion(Arc::new(vec![motion; 40]))
    }

    #[test]
    fn an_object_that_stands_goes_with_the_background() {
        let Anchor::Motion(motions) = motions() else { unreachable!() };
        for place in [[30.0, 200.0], [160.0, 120.0], [300.0, 10.0]] {
            let there = forward(motions.first(), place);
            let back = backward(motions.first(), there);
            assert!((0..2).all(|i| (back[i] - place[i]).abs() < 0.02), "{place:?} {back:?}");
        }
        // The camera turns right by 6 pixels a frame: what it sees goes left.
        assert!(forward(motions.first(), [160.0, 120.0])[0] < 156.0);
        assert_eq!(forward(None, [7.0, 8.0]), [7.0, 8.0]);
        assert_eq!(forward(Some(&GlobalMotion::IDENTITY), [7.0, 8.0]), [7.0, 8.0]);
    }

    #[test]
    fn places_follow_background_and_course() {
        let anchor = motions();
        let course = PasteCourse::draw(&mut Random::new(4));
        let (first, count, index) = (5, 30, 12);
        let places = anchor.places(course, (first, count), (index, [160.0, 120.0]), (320, 240));
        let places = places.unwrap();
        assert_eq!(places.len(), count);
        assert_eq!(places[index - first], Some([160.0, 120.0]));
        let Anchor::Motion(motions) = &anchor else { unreachable!() };
        for frame in 1..count {
            let [before, after] = [frame - 1, frame].map(|f| places[f].unwrap());
            let carried = forward(motions.first(), before);
            let bearings = [frame - 1, frame].map(|f| course.bearing(f as f64 * FRAME));
            for i in 0..2 {
                let own = FOCAL * 320.0 * (bearings[1][i] - bearings[0][i]);
                assert!((after[i] - carried[i] - own).abs() < 0.1, "{frame}: {before:?} {after:?}");
            }
        }
    }
}
