//! Geometry on local points: neighbours, sampling, normals, distances. No IO, no network.
//!
//! | item | what | cost |
//! |---|---|---|
//! | [`KdTree`] | exact k nearest neighbours | build O(n log n), query about O(k + log n) |
//! | [`farthest_point_sampling`] | a spread-out subset | about O(n log n) |
//! | [`estimate_normals`] | normals by PCA | O(n (k + log n)) |
//! | [`propagated`], [`towards`] | which side normals point to | O(n log n) |
//! | [`reconstruct`] | the surface through points with normals, as triangles | O(n log n) |
//! | [`SurfaceDistance`] | distance to a mesh | build O(t log t), query about O(log t) |
//! | [`poisson_disk`], [`uniform`] | points on a triangle mesh | O(n log n), O(n log t) |
//! | [`lone`], [`small_groups`], [`sparse`] | outliers | O(n log n) |
//! | [`smooth`] | denoising, where there is noise | O(n (k + log n)) |
//! | [`one_a_voxel`], [`spaced`] | fewer points | O(n log n), O(n) |
//! | [`Partition`] | space cut into boxes of as many points each | O(n log cells) |
//! | [`Mesh`], [`shape`] | triangle meshes, and some built in | |
//! | [`Rng`] | the random numbers of all of this, fixed for good | |
//!
//! Everything is deterministic: the same values in give the same values out, whatever the number
//! of threads; ties are broken by the lowest index. Coordinates must be finite: who reads them
//! from outside drops or refuses the others first. Indices have 32 bits: what takes points takes up to [`MAX_POINTS`]
//! of them, and panics above; who reads points from outside asks [`check_count`] first.

mod around;
mod axis;
mod cells;
mod farthest;
mod kdtree;
mod limit;
mod mesh;
mod mls;
mod normals;
mod orient;
mod outliers;
mod partition;
mod plane;
mod poisson;
mod poisson_disk;
mod random;
mod shapes;
mod smooth;
mod surface_distance;
mod thin;
mod uniform;

pub use axis::common_axis;
pub use cells::{Reach, cell_area, one_sided};
pub use farthest::{farthest_point_sampling, farthest_point_sampling_beside, scaled_farthest_point_sampling};
pub use kdtree::{KdTree, Neighbour, Walk};
pub use limit::{MAX_POINTS, TooManyPoints, check_count, indices};
pub use mesh::{Mesh, MeshError};
pub use mls::project_to_surface;
pub use normals::estimate_normals;
pub use normals::{normal, normals_of_four};
pub use orient::{propagated, towards};
pub use outliers::{far, lone, small_groups, sparse};
pub use partition::{NoPartition, Partition, Split};
pub use plane::{Plane, quadratic_residual};
pub use poisson::{PoissonError, PoissonSettings, Surface, reconstruct};
pub use poisson_disk::poisson_disk;
pub use random::Rng;
pub use shapes::{SHAPES, shape};
pub use smooth::{Smoothed, Smoothing, smooth};
pub use surface_distance::SurfaceDistance;
pub use thin::{one_a_voxel, spaced};
pub use uniform::{SampleError, uniform};
