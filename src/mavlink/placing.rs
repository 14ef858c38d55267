//! Why objects that are followed are not put on the map: counted, and said when it goes on.

/// Why an object has no direction in the world, or no place to count it from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum UnplacedCause {
    /// No autopilot is heard.
    NoAutopilot,
    /// The autopilot sends no attitude.
    NoAttitude,
    /// Attitudes come too rarely: the picture's own motion and angular velocities do not bridge the time between them.
    RareAttitude,
    /// The gimbal does not say where the camera looks.
    Gimbal,
    /// The autopilot sends no position.
    NoPosition,
}

impl UnplacedCause {
    /// All of them, in the order of their numbers.
    pub const ALL: [Self; 5] =
        [Self::NoAutopilot, Self::NoAttitude, Self::RareAttitude, Self::Gimbal, Self::NoPosition];
}

impl core::fmt::Display for UnplacedCause {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(match self {
            Self::NoAutopilot => "no autopilot was heard",
            Self::NoAttitude => "no ATTITUDE or ATTITUDE_QUATERNION came",
            Self::RareAttitude => {
                "attitudes came too rarely, without HIGHRES_IMU or SCALED_IMU, and the picture showed no ground to go by"
            }
            Self::Gimbal => "no GIMBAL_DEVICE_ATTITUDE_STATUS came within 0.3 s",
            Self::NoPosition => "no GLOBAL_POSITION_INT came",
        })
    }
}

/// Objects of this long are judged together, microseconds.
const WINDOW_US: i64 = 2_000_000;

/// Time from one report of the same cause to the next, microseconds.
const AGAIN_US: i64 = 60_000_000;

/// Objects counted by what became of them.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct PlacingCounts {
    /// Those that have a direction in the world.
    pub placed: u32,
    /// Those that have none, by [`UnplacedCause`].
    pub lost: [u32; UnplacedCause::ALL.len()],
}

impl PlacingCounts {
    /// Number of objects, with and without a place.
    pub fn all(&self) -> u32 {
        self.lost.iter().fold(self.placed, |sum, lost| sum.saturating_add(*lost))
    }

    /// The commonest cause and its number, where there is any.
    pub fn worst(&self) -> Option<(UnplacedCause, u32)> {
        let lost = UnplacedCause::ALL.into_iter().zip(self.lost).filter(|(_, lost)| *lost > 0);
        lost.max_by_key(|(_, lost)| *lost)
    }

    fn count(&mut self, cause: Option<UnplacedCause>) {
        let place = match cause {
            Some(cause) => &mut self.lost[cause as usize],
            None => &mut self.placed,
        };
        *place = place.saturating_add(1);
    }
}

/// A change that others are to know of.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum News {
    /// Much is lost, for this reason.
    Lost(UnplacedCause),
    /// Nothing is lost any more.
    Good,
}

/// Counts of objects with and without a place since the start, and the reports that are due.
#[derive(Debug, Clone, Copy, Default)]
pub struct Placing {
    total: PlacingCounts,
    window: PlacingCounts,
    since_us: Option<i64>,
    reported: Option<(UnplacedCause, i64)>,
}

impl Placing {
    /// An object in one frame (`None`: it has a direction in the world).
    pub fn object(&mut self, cause: Option<UnplacedCause>) {
        self.total.count(cause);
        self.window.count(cause);
    }

    /// A frame without objects that would have had none either.
    pub fn frame(&mut self, cause: Option<UnplacedCause>) {
        self.window.count(cause);
    }

    /// Counts since the start, one for each object in each frame.
    pub fn counts(&self) -> &PlacingCounts {
        &self.total
    }

    /// The cause that was reported last and still holds.
    pub fn current(&self) -> Option<UnplacedCause> {
        self.reported.map(|(cause, _)| cause)
    }

    /// After a frame: news where more than a quarter of the last two seconds' objects were lost, and again after a minute, or
    /// none were lost any more.
    pub fn news(&mut self, now_us: i64) -> Option<News> {
        let since = *self.since_us.get_or_insert(now_us);
        if (0..WINDOW_US).contains(&now_us.saturating_sub(since)) {
            return None;
        }
        self.since_us = Some(now_us);
        let window = core::mem::take(&mut self.window);
        match (window.worst(), self.reported) {
            (Some((cause, lost)), reported) if lost > window.all() / 4 => {
                let known = reported.is_some_and(|(before, at_us)| {
                    before == cause && now_us.saturating_sub(at_us) < AGAIN_US
                });
                (!known).then(|| {
                    self.reported = Some((cause, now_us));
                    News::Lost(cause)
                })
            }
            (None, Some(_)) if window.placed > 0 => {
                self.reported = None;
                Some(News::Good)
            }
            _ => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// News of ten seconds with a frame each 0.1 s.
    fn seconds(
        placing: &mut Placing,
        from: i64,
        count: i64,
        cause: impl Fn(i64) -> Option<UnplacedCause>,
    ) -> std::vec::Vec<News> {
        let frames = (from * 10..(from + count) * 10).filter_map(|frame| {
            placing.object(cause(frame));
            placing.news(frame * 100_000)
        });
        frames.collect()
    }

    #[test]
    fn what_goes_on_is_said_once_a_minute_and_its_end_once() {
        let mut placing = Placing::default();
        assert_eq!(seconds(&mut placing, 0, 10, |_| None), []);
        let rare = |frame: i64| (frame % 2 == 0).then_some(UnplacedCause::RareAttitude);
        assert_eq!(seconds(&mut placing, 10, 50, rare), [News::Lost(UnplacedCause::RareAttitude)]);
        assert_eq!(placing.current(), Some(UnplacedCause::RareAttitude));
        assert_eq!(seconds(&mut placing, 60, 30, rare), [News::Lost(UnplacedCause::RareAttitude)]);
        assert_eq!(seconds(&mut placing, 90, 10, |_| Some(UnplacedCause::NoPosition)).len(), 1);
        assert_eq!(seconds(&mut placing, 100, 10, |_| None), [News::Good]);
        assert_eq!(placing.current(), None);
        let counts = placing.counts();
        assert_eq!(
            (counts.all(), counts.worst()),
            (1100, Some((UnplacedCause::RareAttitude, 400)))
        );
        assert_eq!((counts.placed, counts.lost[UnplacedCause::NoPosition as usize]), (600, 100));
    }

    #[test]
    fn a_single_frame_is_no_news() {
        let mut placing = Placing::default();
        let one = |frame: i64| (frame % 10 == 0).then_some(UnplacedCause::Gimbal);
        assert_eq!(seconds(&mut placing, 0, 20, one), []);
        // A clock that is set back starts another window.
        assert_eq!(placing.news(-5_000_000), None);
    }
}
