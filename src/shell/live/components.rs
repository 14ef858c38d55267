//! Parts of the service as the settings ask for them: parameters, links, the MAVLink component.

use super::config::ServiceConfig;
use crate::mavlink::component::parameters::Parameters;
use crate::mavlink::component::{CameraComponent, ComponentConfig, Naming};
use crate::mavlink::messages::adsb::{Assume, Callsign};
use crate::mavlink::messages::status::HeartbeatType;
use crate::shell::link::{LinkSpec, params};
use crate::shell::support::keeper::Keeper;
use std::path::Path;
use std::vec::Vec;

/// The parameters that are kept in a file, and who keeps it. A file that cannot be read is left as it is.
pub(super) fn parameters(path: Option<&Path>) -> (Parameters, Option<Keeper>) {
    let Some(path) = path else { return (Parameters::default(), None) };
    let keeper = || {
        let keeper = Keeper::start(path);
        keeper.map_err(|error| tracing::error!("parameters are not kept: {error}")).ok()
    };
    match params::load(path) {
        Ok(parameters) => (parameters, keeper()),
        Err(error) => {
            tracing::error!(
                "{}: {error}; the parameters' defaults are used, changes are not kept",
                path.display()
            );
            (Parameters::default(), None)
        }
    }
}

/// The links of the settings.
pub(super) fn specs(config: &ServiceConfig) -> Vec<LinkSpec> {
    config.links.iter().map(|link| link.0.clone()).collect()
}

/// Settings of the component that do not change.
pub(super) fn component(config: &ServiceConfig) -> ComponentConfig {
    let defaults = ComponentConfig::default();
    let pixels = |side: u32| u16::try_from(side).unwrap_or(u16::MAX);
    ComponentConfig {
        system_id: config.system_id,
        component_id: config.component_id,
        camera: config.camera_component.map(|component_id| CameraComponent {
            component_id,
            width: pixels(config.camera.width),
            height: pixels(config.camera.height),
        }),
        gimbal: config.camera.gimbal,
        heartbeat: match config.heartbeat_type.as_str() {
            "adsb" => HeartbeatType::Adsb,
            "flarm" => HeartbeatType::Flarm,
            _ => HeartbeatType::OnboardController,
        },
        naming: naming(config),
        // Three frames of a slow camera.
        stall_us: defaults.stall_us.max(3_000_000 / i64::from(config.camera.rate)),
        ..defaults
    }
}

/// Names of objects by the settings.
pub(super) fn naming(config: &ServiceConfig) -> Naming {
    let assume = match config.traffic.assume.as_str() {
        "aircraft" => Assume::Aircraft,
        _ => Assume::Drone,
    };
    let mut naming = Naming { assume, ..Naming::default() };
    for (place, callsign) in naming.fleet.iter_mut().zip(&config.traffic.fleet) {
        *place = Callsign::new(callsign.as_bytes());
    }
    naming
}
