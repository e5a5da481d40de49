//! A tile's points: its own, and those around it.

use densecloud_cloud::{Attribute, Cloud, Origin, Position, Values};
use densecloud_formats::{Adaptation, Block};

use crate::chunk::read_all;
use crate::{Folder, TilesError};

/// The points of a tile, and those around it, as they lie on the disk: the last column has their rows in the input.
pub(crate) fn points_of(folder: &Folder, tile: u32) -> Result<(Block, Block), TilesError> {
    let own = read_all(&folder.own(tile))?.unwrap_or_default();
    Ok((own, read_all(&folder.around(tile))?.unwrap_or_default()))
}

/// A tile with what is around it, as a cloud.
pub(crate) struct TileCloud {
    /// All of its points, in the input's order.
    pub(crate) cloud: Cloud,
    /// Of each the row in the input.
    pub(crate) rows: Vec<u32>,
    /// The tile's own: their places in the cloud.
    pub(crate) own: Vec<u32>,
}

impl TileCloud {
    /// Reads a tile. `attributes` are those of the input, without values.
    pub(crate) fn read(
        folder: &Folder,
        tile: u32,
        attributes: &[Attribute],
        adaptation: &Adaptation,
        origin: &Origin,
    ) -> Result<Self, TilesError> {
        let (mut all, around) = points_of(folder, tile)?;
        let count = all.positions.len();
        append(&mut all, around);
        let rows = match all.columns.pop() {
            Some(Values::U32(rows)) if all.columns.len() == attributes.len() => rows,
            _ => return Err(TilesError::broken(&folder.own(tile), "it has other columns than planned")),
        };
        let mut order: Vec<u32> = densecloud_geometry::indices(rows.len()).collect();
        order.sort_unstable_by_key(|&place| rows[place as usize]);
        let attribute = |(attribute, values): (&Attribute, &Values)| Attribute {
            name: attribute.name.clone(),
            values: values.gather(&order),
        };
        let mut attributes: Vec<Attribute> = attributes.iter().zip(&all.columns).map(attribute).collect();
        adaptation.apply(&mut attributes);
        let positions = order.iter().map(|&place| all.positions[place as usize]).collect();
        let is_own = |place: &u32| (order[*place as usize] as usize) < count;
        Ok(Self {
            cloud: Cloud { positions, attributes, origin: origin.clone(), ..Cloud::default() },
            rows: order.iter().map(|&place| rows[place as usize]).collect(),
            own: densecloud_geometry::indices(order.len()).filter(is_own).collect(),
        })
    }

    /// The lowest and the highest coordinates of the tile's own points.
    pub(crate) fn bounds(&self) -> [Position; 2] {
        let mut bounds = [[f64::INFINITY; 3], [f64::NEG_INFINITY; 3]];
        for &place in &self.own {
            widen(&mut bounds, self.cloud.positions[place as usize]);
        }
        bounds
    }
}

/// Makes room for a position between the lowest and the highest coordinates.
pub(crate) fn widen(bounds: &mut [Position; 2], p: Position) {
    let [lowest, highest] = bounds;
    for ((low, high), c) in lowest.iter_mut().zip(highest).zip(p) {
        (*low, *high) = (low.min(c), high.max(c));
    }
}

fn append(all: &mut Block, mut more: Block) {
    if all.positions.is_empty() {
        *all = more;
        return;
    }
    all.positions.append(&mut more.positions);
    all.columns.iter_mut().zip(&mut more.columns).for_each(|(column, more)| column.append(more));
}
