//! File formats: bytes in, a [`Cloud`](densecloud_cloud::Cloud) or a [`Mesh`](densecloud_geometry::Mesh)
//! out, and back.
//!
//! | format | clouds | meshes |
//! |---|---|---|
//! | PLY (ascii, binary of both byte orders; any scalar types; attributes) | read, write | read, write |
//! | XYZ and its relatives (text columns; attributes) | read, write | |
//! | LAS, LAZ, COPC (every point format, extra bytes) | read, write | |
//! | PCD (ascii, binary, compressed) | read, write | |
//! | E57 (all scans, attributes) | read, write | |
//! | NumPy `.npy` (tables and structures of any numbers) | read, write | |
//! | COLMAP (`points3D.txt`, `points3D.bin`, without tracks) | read, write | |
//! | PTX (all scans) | read | |
//! | KITTI, nuScenes (sweeps; only where a caller says so) | read | |
//! | OFF | read (vertices) | read |
//! | OBJ | read (vertices) | write |
//! | STL, binary glTF (`.glb`) | | write |
//!
//! A reader is opened first and read second: [`CloudReader::open`] parses the header alone, so that limits are checked,
//! and a refusal sent, before any point is read. [`CloudReader::read`] returns all points, [`CloudReader::next_block`]
//! some of them at a time in memory that does not grow with the file, but for the formats that it names. A header's
//! claim is never believed: memory grows with the data, and a claim that the data do not keep is an error that says
//! where the data ended. The counts in text (`.pts`) are notes of people's: one that is off is told, and all points are
//! read.
//!
//! A format is a module that implements the traits of `kind.rs`, and an entry in `registry.rs`. No other file names it,
//! but for `mesh.rs`.
//!
//! Everything here is blocking `std::io`, and nothing here panics on bad input.
//!
//! ```
//! use densecloud_formats::{CloudReader, Format, Limits, PlyEncoding, Scalar, encode};
//!
//! let text = "0 0 0\n1 0 0\n0 1 0\n";
//! let cloud = CloudReader::open(text.as_bytes(), Limits::default())?.read()?;
//! let format = Format::Ply { encoding: PlyEncoding::BinaryLittleEndian, scalar: Scalar::F32 };
//! let bytes = encode(Vec::new(), format, &cloud.positions, &cloud.attributes, &cloud.origin)?;
//! assert_eq!(Some(bytes.len() as u64), format.encoded_len(3, &cloud.attributes, &cloud.origin));
//! # Ok::<(), densecloud_formats::FormatError>(())
//! ```

mod axes;
mod block;
mod columns;
mod convert;
mod error;
mod first_bytes;
mod format;
mod kind;
mod known;
mod layers;
mod mesh;
mod mesh_write;
mod names;
mod numbers;
mod reader;
mod reading;
mod registry;
mod source;
mod spool;
#[cfg(test)]
mod tests;
mod text;
mod writer;

mod colmap;
mod e57;
mod kitti;
mod las;
mod npy;
mod obj;
mod off;
mod pcd;
mod ply;
mod ptx;
mod xyz;

pub use convert::Adaptation;
pub use error::{FormatError, Place};
pub use first_bytes::FirstBytes;
pub use format::{Header, Limits, Scalar};
pub use mesh::{read_mesh, read_mesh_file};
pub use mesh_write::{MeshFormat, write_mesh};
pub use npy::npy_header;
pub use pcd::PcdEncoding;
pub use ply::PlyEncoding;
pub use reader::{Block, CloudReader, ColumnName, Ending, read_cloud_file, read_cloud_file_as};
pub use reading::{AxisColumns, Bounds, InputFormat, Reading, UnknownName};
pub use registry::Format;
pub use spool::set_temp_folder;
pub use writer::{CloudPlan, CloudWriter, Encoded, encode, encode_spooled};
pub use xyz::{Decimal, Separator};
