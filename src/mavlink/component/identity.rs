//! Names of the objects: an ICAO address and a callsign that no other lookout on the vehicle gives.

use super::Component;
use crate::mavlink::messages::adsb::{Assume, Callsign, IDS, Identity};
use crate::tracking::traffic::MAX_TRAFFIC;

/// Most callsigns of the own fleet.
pub const FLEET: usize = 16;

/// Names of objects, and callsigns that are not reported.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Naming {
    /// Aircraft type that objects are reported as.
    pub assume: Assume,
    /// Callsigns of the own fleet: a track that an ADSB_VEHICLE of one of them explains gets no text, ADSB_VEHICLE or
    /// COLLISION. Obstacle messages still hold it.
    pub fleet: [Option<Callsign>; FLEET],
}

/// The address of a track: a slot of [`IDS`], given in turn, so that an address is used again as late as possible.
#[derive(Debug, Clone, Copy)]
struct IdSlot {
    track: u16,
    slot: u32,
}

/// Which track has which slot.
#[derive(Debug, Default)]
pub(super) struct Slots {
    taken: heapless::Vec<IdSlot, MAX_TRAFFIC>,
    next: u32,
}

impl Slots {
    /// Gives back the slots of tracks that ended, and gives one to each of `tracks` that has none.
    pub(super) fn update(&mut self, tracks: impl Iterator<Item = u16> + Clone) {
        self.taken.retain(|taken| tracks.clone().any(|track| track == taken.track));
        for track in tracks {
            if self.taken.is_full() || self.get(track).is_some() {
                continue;
            }
            while self.taken.iter().any(|taken| taken.slot == self.next) {
                self.next = (self.next + 1) % IDS;
            }
            let _ = self.taken.push(IdSlot { track, slot: self.next });
            self.next = (self.next + 1) % IDS;
        }
    }

    fn get(&self, track: u16) -> Option<u32> {
        self.taken.iter().find(|taken| taken.track == track).map(|taken| taken.slot)
    }
}

impl Component {
    /// The name of a track: the callsign of the aircraft that explains it, else one made from its number.
    pub fn callsign(&self, track: u16) -> Callsign {
        let own = || Callsign::of_track(self.config.component_id, track);
        self.aircraft_of(track).and_then(|aircraft| aircraft.callsign).unwrap_or_else(own)
    }

    /// Whether a track is explained by an aircraft of the own fleet.
    pub fn is_muted(&self, track: u16) -> bool {
        let callsign = self.aircraft_of(track).and_then(|aircraft| aircraft.callsign);
        callsign.is_some() && self.config.naming.fleet.contains(&callsign)
    }

    /// Its identity on the map; `None` for a track that is not confirmed.
    pub(super) fn identity(&self, track: u16) -> Option<Identity> {
        let slot = self.slots.get(track)?;
        let (component, assume) = (self.config.component_id, self.config.naming.assume);
        Some(Identity::new(component, slot, self.callsign(track), assume))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;
    use std::vec::Vec;

    #[test]
    fn an_address_is_kept_and_given_again_late() {
        let mut slots = Slots::default();
        let mut last_end = [None; IDS as usize];
        for step in 0..500u16 {
            // Four tracks at a time, each of them for four steps.
            let living: Vec<u16> = (step..step + 4).collect();
            let before: Vec<_> = living.iter().map(|&track| slots.get(track)).collect();
            slots.update(living.iter().copied());
            let after: Vec<u32> = living.iter().map(|&track| slots.get(track).unwrap()).collect();
            for (before, after) in before.iter().zip(&after) {
                assert!(before.is_none_or(|before| before == *after));
            }
            assert_eq!(after.iter().collect::<BTreeSet<_>>().len(), 4);
            let new = after[3] as usize;
            assert!(last_end[new].is_none_or(|end| step - end >= 58), "{step}");
            last_end[after[0] as usize] = Some(step);
        }
    }
}
