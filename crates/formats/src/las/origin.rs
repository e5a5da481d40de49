//! What a LAS file tells beside its points, kept as it is.

use std::any::Any;

use densecloud_cloud::{FormatExtra, Origin};

/// What a LAS file has in its header and its records, beside the points.
#[derive(Debug, Clone, Default, PartialEq)]
pub(crate) struct LasOrigin {
    /// The version, such as (1, 4).
    pub(crate) version: (u8, u8),
    /// The number of the point format, 0 to 10.
    pub(crate) point_format: u8,
    /// The steps that coordinates are stored in, an axis each.
    pub(crate) scale: [f64; 3],
    /// The coordinates that step 0 stands for, an axis each.
    pub(crate) offset: [f64; 3],
    /// The file source id: a flight line.
    pub(crate) file_source_id: u16,
    /// The bits of the global encoding, the kind of GPS time among them.
    pub(crate) global_encoding: u16,
    /// The project's id.
    pub(crate) guid: [u8; 16],
    /// What made the points.
    pub(crate) system_identifier: [u8; 32],
    /// The day of the year, and the year, of the file's creation.
    pub(crate) created: (u16, u16),
    /// The variable length records that are true of any points of the same place: not those of the
    /// compression, an index, waveforms and extra bytes.
    pub(crate) records: Vec<LasRecord>,
    /// How the extra bytes are described.
    pub(crate) extra: Vec<LasExtra>,
    /// Whether the file has an index of its points (COPC, LAX).
    pub(crate) is_indexed: bool,
}

/// A variable length record of a LAS file.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(crate) struct LasRecord {
    /// Who defines it.
    pub(crate) user_id: String,
    /// Which of theirs it is.
    pub(crate) id: u16,
    /// For people.
    pub(crate) description: String,
    /// The content.
    pub(crate) data: Vec<u8>,
    /// Whether it stands after the points, where there is room for more than 64 KiB.
    pub(crate) is_extended: bool,
}

impl LasOrigin {
    /// What a LAS file has told of a cloud, if it comes from one.
    pub(crate) fn of(origin: &Origin) -> Option<&Self> {
        origin.extra.as_ref()?.get()
    }
}

impl FormatExtra for LasOrigin {
    /// Records of the coordinate system are not among them: [`Origin::crs`] says the same.
    fn lost_elsewhere(&self) -> Vec<String> {
        let others = self.records.iter().filter(|record| !record.is_crs());
        let named: Vec<String> = others.map(|r| format!("{} {}", r.user_id, r.id)).collect();
        if named.is_empty() { named } else { vec![format!("LAS records ({})", named.join(", "))] }
    }

    fn equals(&self, other: &dyn FormatExtra) -> bool {
        (other as &dyn Any).downcast_ref() == Some(self)
    }
}

impl LasRecord {
    /// Whether it tells the coordinate system; copies that libLAS makes count, too.
    pub(crate) fn is_crs(&self) -> bool {
        match self.user_id.to_ascii_lowercase().as_str() {
            "lasf_projection" => matches!(self.id, 2111 | 2112 | 34_735..=34_737),
            "liblas" => self.id == 2112,
            _ => false,
        }
    }
}

/// What the record of extra bytes says of an attribute.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct LasExtra {
    /// The attribute's name in the cloud.
    pub(crate) name: String,
    /// Its entry in the record: 192 bytes with type, name, scale, offset and description.
    pub(crate) entry: Vec<u8>,
}
