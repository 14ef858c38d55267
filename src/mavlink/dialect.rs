//! The MAVLink dialect of Lookout: types of the messages that it sends, receives or requests, and the check of frames.
//!
//! The types are generated from `dialect.xml` by `build.rs`. A link carries many other messages; their frames are
//! recognised (see [`ArduPilotFrames`]) and then left alone.

use mavlink_core::Dialect;
use mavlink_core::error::ParserError;
use mavlink_core::{MAVLinkMessageRaw, MavlinkVersion, Message};

mod generated {
    include!(concat!(env!("OUT_DIR"), "/mod.rs"));
}

pub use generated::dialect::*;

/// Frames of all messages of ArduPilot's dialect, of which only those of [`MavMessage`] can be decoded.
///
/// The checksum of a frame covers a byte that depends on the message, CRC_EXTRA. Where it is not known, a reader cannot
/// distinguish a frame from noise: it searches for the next one inside its payload, and may wait there for bytes that are not
/// part of any frame. Source: <https://mavlink.io/en/guide/serialization.html#crc_extra>.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct ArduPilotFrames;

impl ArduPilotFrames {
    /// Whether the checksum of `frame` is right. `false` for messages of other dialects.
    pub fn has_valid_crc(frame: &MAVLinkMessageRaw) -> bool {
        crc_extra(frame.message_id()).is_some_and(|extra| match frame {
            MAVLinkMessageRaw::V1(frame) => frame.has_valid_crc_with_extra_crc(extra),
            MAVLinkMessageRaw::V2(frame) => frame.has_valid_crc_with_extra_crc(extra),
        })
    }
}

impl Dialect for ArduPilotFrames {
    type Message = MavMessage;
    type EncodeError = core::convert::Infallible;

    fn message_id(&self, message: &MavMessage) -> u32 {
        message.message_id()
    }

    fn extra_crc(&self, message_id: u32) -> Option<u8> {
        crc_extra(message_id)
    }

    fn decode(
        &self,
        version: MavlinkVersion,
        message_id: u32,
        payload: &[u8],
    ) -> Result<MavMessage, ParserError> {
        MavMessage::parse(version, message_id, payload)
    }

    fn encode(
        &self,
        version: MavlinkVersion,
        message: &MavMessage,
        payload: &mut [u8],
    ) -> Result<usize, Self::EncodeError> {
        Ok(message.ser(version, payload))
    }
}

/// CRC_EXTRA of the message `id`; `None` for messages that are not in ArduPilot's dialect.
fn crc_extra(id: u32) -> Option<u8> {
    let place = CRC_EXTRA.binary_search_by_key(&id, |&(id, _)| id).ok()?;
    Some(CRC_EXTRA[place].1)
}

/// Number and CRC_EXTRA of each message of ArduPilot's dialect, in rising order of numbers. Source: ardupilotmega.xml of
/// <https://github.com/mavlink/mavlink> as of the crate `mavlink` 0.21.0, compared with pymavlink in `tests/receivers`.
#[rustfmt::skip]
const CRC_EXTRA: [(u32, u8); 325] = [
    (0, 50), (1, 124), (2, 137), (4, 237), (5, 217), (6, 104), (7, 119), (8, 117), (11, 89), (20, 214), (21, 159),
    (22, 220), (23, 168), (24, 24), (25, 23), (26, 170), (27, 144), (28, 67), (29, 115), (30, 39), (31, 246),
    (32, 185), (33, 104), (34, 237), (35, 244), (36, 222), (37, 212), (38, 9), (39, 254), (40, 230), (41, 28),
    (42, 28), (43, 132), (44, 221), (45, 232), (46, 11), (47, 153), (48, 41), (49, 39), (50, 78), (51, 196), (54, 15),
    (55, 3), (61, 167), (62, 183), (63, 119), (64, 191), (65, 118), (66, 148), (67, 21), (69, 243), (70, 124),
    (73, 38), (74, 20), (75, 158), (76, 152), (77, 143), (80, 14), (81, 106), (82, 49), (83, 22), (84, 143),
    (85, 140), (86, 5), (87, 150), (89, 231), (90, 183), (91, 63), (92, 54), (93, 47), (100, 175), (101, 102),
    (102, 158), (103, 208), (104, 56), (105, 93), (106, 138), (107, 108), (108, 32), (109, 185), (110, 84), (111, 34),
    (112, 174), (113, 124), (114, 237), (115, 4), (116, 76), (117, 128), (118, 56), (119, 116), (120, 134),
    (121, 237), (122, 203), (123, 250), (124, 87), (125, 203), (126, 220), (127, 25), (128, 226), (129, 46),
    (130, 29), (131, 223), (132, 85), (133, 6), (134, 229), (135, 203), (136, 1), (137, 195), (138, 109), (139, 168),
    (140, 181), (141, 47), (142, 72), (143, 131), (144, 127), (146, 103), (147, 154), (148, 178), (149, 200),
    (150, 134), (151, 219), (152, 208), (153, 188), (154, 84), (155, 22), (156, 19), (157, 21), (158, 134), (160, 78),
    (161, 68), (162, 189), (163, 127), (164, 154), (165, 21), (166, 21), (167, 144), (168, 1), (169, 234), (170, 73),
    (171, 181), (172, 22), (173, 83), (174, 167), (175, 138), (176, 234), (177, 240), (178, 47), (179, 189),
    (180, 52), (181, 174), (182, 229), (183, 85), (184, 159), (185, 186), (186, 72), (191, 92), (192, 36), (193, 71),
    (194, 98), (195, 120), (200, 134), (201, 205), (214, 69), (215, 101), (216, 50), (217, 202), (218, 17),
    (219, 162), (225, 208), (226, 207), (230, 163), (231, 105), (232, 151), (233, 35), (234, 150), (235, 179),
    (241, 90), (242, 104), (243, 85), (244, 95), (245, 130), (246, 184), (247, 81), (248, 8), (249, 204), (250, 49),
    (251, 170), (252, 44), (253, 83), (254, 46), (256, 71), (257, 131), (258, 187), (259, 92), (260, 146), (261, 179),
    (262, 12), (263, 133), (264, 49), (265, 26), (266, 193), (267, 35), (268, 14), (269, 109), (270, 59), (271, 22),
    (275, 126), (276, 18), (277, 62), (280, 70), (281, 48), (282, 123), (283, 74), (284, 99), (285, 137), (286, 210),
    (287, 1), (288, 20), (290, 251), (291, 10), (295, 234), (296, 158), (299, 19), (300, 217), (301, 243), (310, 28),
    (311, 95), (320, 243), (321, 88), (322, 243), (323, 78), (324, 132), (330, 23), (331, 91), (332, 236), (333, 231),
    (334, 72), (335, 225), (336, 245), (339, 199), (340, 99), (345, 209), (350, 232), (360, 11), (361, 93), (370, 75),
    (371, 10), (372, 26), (373, 117), (375, 251), (376, 199), (380, 232), (385, 147), (386, 132), (387, 4), (388, 8),
    (390, 156), (395, 0), (396, 50), (397, 182), (400, 110), (401, 183), (410, 160), (411, 106), (412, 33), (413, 77),
    (435, 134), (436, 193), (437, 30), (440, 66), (9000, 113), (9005, 117), (10001, 209), (10002, 186), (10003, 4),
    (10004, 133), (10005, 103), (10006, 193), (10007, 71), (10008, 240), (10151, 195), (11000, 134), (11001, 15),
    (11002, 234), (11003, 64), (11004, 11), (11005, 93), (11010, 46), (11011, 106), (11020, 205), (11030, 144),
    (11031, 133), (11032, 85), (11033, 195), (11034, 79), (11035, 128), (11036, 177), (11037, 130), (11038, 47),
    (11039, 142), (11040, 132), (11041, 208), (11042, 201), (11043, 193), (11044, 189), (11060, 162), (12900, 114),
    (12901, 254), (12902, 140), (12903, 249), (12904, 77), (12905, 49), (12915, 94), (12918, 139), (12919, 7),
    (12920, 20), (42000, 227), (42001, 239), (50001, 246), (50002, 181), (50003, 62), (50004, 240), (50005, 152),
    (52000, 13), (52001, 239),
];

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_table_holds_the_messages_that_are_decoded() {
        assert!(CRC_EXTRA.is_sorted_by(|a, b| a.0 < b.0));
        for &id in MavMessage::all_ids() {
            assert_eq!(crc_extra(id), Some(MavMessage::extra_crc(id)), "message {id}");
        }
        // VIBRATION is in the dialect and not decoded; 77777 is no message.
        assert_eq!((crc_extra(241), MavMessage::extra_crc(241)), (Some(90), 0));
        assert_eq!(crc_extra(77_777), None);
    }
}
