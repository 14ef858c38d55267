//! MAVLink (feature `mavlink`): tracks and alerts as messages, and the component that speaks and answers on a link.
//!
//! In: frames' detections, attitudes, and received MAVLink frames. Out: MAVLink frames. Imports every folder below but
//! the shell. `messages` are pure conversions, `component` keeps the protocol's state, `lookout` joins tracker and
//! component.

pub mod component;
pub mod dialect;
pub mod lookout;
pub mod messages;
pub mod placing;
