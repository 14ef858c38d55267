//! Requests to other components, repeated until they are answered.

use crate::mavlink::dialect::{COMMAND_LONG_DATA, MavCmd};
use crate::mavlink::messages::Payload;

/// Microseconds after which an unanswered request is made again.
const RETRY_US: i64 = 700_000;
/// How often a request is made before it counts as unanswered.
const TRIES: u32 = 4;

/// A request that is made again until it is answered.
#[derive(Debug, Clone, Copy, Default)]
pub struct RepeatedRequest {
    tries: u32,
    due_us: i64,
}

impl RepeatedRequest {
    /// Whether to ask now.
    pub fn ask(&mut self, now_us: i64) -> bool {
        let ask = self.tries < TRIES && now_us >= self.due_us;
        if ask {
            self.tries += 1;
            self.due_us = now_us + RETRY_US;
        }
        ask
    }
}

/// COMMAND_LONG with two parameters.
pub fn command_long(to: (u8, u8), command: MavCmd, [param1, param2]: [f32; 2]) -> Payload {
    Payload::new(&COMMAND_LONG_DATA {
        param1,
        param2,
        command,
        target_system: to.0,
        target_component: to.1,
        ..COMMAND_LONG_DATA::default()
    })
}
