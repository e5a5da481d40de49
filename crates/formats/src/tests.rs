//! Whole files in, clouds and meshes out, and back.

mod blocks;
mod broken;
mod colmap_files;
mod conversions;
mod copc_files;
mod dialects;
mod e57_digits;
mod e57_files;
mod e57_scans;
mod findings;
mod hostile_names;
mod kitti_files;
mod known;
mod las_counts;
mod las_files;
mod layers;
mod laz_chunks;
mod mesh_clouds;
mod meshes;
mod npy_files;
mod pcd_files;
mod places;
mod ptx_files;
mod round_trips;
mod text;
mod told;

use super::*;
use densecloud_cloud::{Attribute, Cloud, Position, Values};

fn read(bytes: &[u8]) -> Result<Cloud, FormatError> {
    CloudReader::open(bytes, Limits::default())?.read()
}

/// As [`read`], without the hash and the kind of file, which no cloud has that was never in one.
fn read_content(bytes: &[u8]) -> Result<Cloud, FormatError> {
    let mut cloud = read(bytes)?;
    (cloud.origin.sha256, cloud.origin.named_in) = (None, None);
    Ok(cloud)
}

fn write(positions: &[Position], format: Format) -> Vec<u8> {
    let mut writer = CloudWriter::new(Vec::new(), format, positions.len() as u64).expect("a header");
    writer.write(positions).expect("points");
    writer.finish().expect("the promised count")
}

fn ply(encoding: PlyEncoding, scalar: Scalar) -> Format {
    Format::Ply { encoding, scalar }
}

const ENCODINGS: [PlyEncoding; 3] =
    [PlyEncoding::Ascii, PlyEncoding::BinaryLittleEndian, PlyEncoding::BinaryBigEndian];

/// Gives a byte at a time, as the slowest of sockets.
struct Drip<'a>(&'a [u8]);

impl std::io::Read for Drip<'_> {
    fn read(&mut self, out: &mut [u8]) -> std::io::Result<usize> {
        let n = self.0.len().min(out.len()).min(1);
        out[..n].copy_from_slice(&self.0[..n]);
        self.0 = &self.0[n..];
        Ok(n)
    }
}
