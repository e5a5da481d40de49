//! Clouds made of whole numbers, `+ - * /` and square roots alone, which are the same on every machine.

/// A cloud, and what each of its points has beside its position.
pub(super) struct Points {
    pub(super) positions: Vec<[f64; 3]>,
    pub(super) columns: Vec<Column>,
}

/// One number a point; each is one that `kind` has.
pub(super) struct Column {
    pub(super) name: &'static str,
    pub(super) kind: Kind,
    pub(super) values: Vec<f64>,
}

#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Kind {
    U8,
    U16,
    U32,
    I32,
    F32,
    F64,
}

impl Kind {
    pub(super) fn size(self) -> usize {
        self.little(0.0).len()
    }

    /// A number's bytes, the least first.
    pub(super) fn little(self, value: f64) -> Vec<u8> {
        match self {
            Self::U8 => vec![value as u8],
            Self::U16 => (value as u16).to_le_bytes().into(),
            Self::U32 => (value as u32).to_le_bytes().into(),
            Self::I32 => (value as i32).to_le_bytes().into(),
            Self::F32 => (value as f32).to_le_bytes().into(),
            Self::F64 => value.to_le_bytes().into(),
        }
    }

    /// The shortest text that is this number again.
    pub(super) fn text(self, value: f64) -> String {
        if self == Self::F32 { (value as f32).to_string() } else { value.to_string() }
    }
}

impl Points {
    fn of(points: usize, position: impl Fn(usize) -> [f64; 3]) -> Self {
        Self { positions: (0..points).map(position).collect(), columns: Vec::new() }
    }

    pub(super) fn with(mut self, name: &'static str, kind: Kind, value: impl Fn(usize) -> f64) -> Self {
        let values = (0..self.positions.len()).map(value).collect();
        self.columns.push(Column { name, kind, values });
        self
    }

    /// Colours that change from place to place, so that means of neighbours differ from each of them.
    pub(super) fn coloured(self) -> Self {
        self.with("red", Kind::U8, |i| (i * 7 % 256) as f64)
            .with("green", Kind::U8, |i| (chance(i, 31) * 256.0).floor())
            .with("blue", Kind::U8, |i| (255 - i % 256) as f64)
    }

    pub(super) fn measured(self) -> Self {
        self.with("intensity", Kind::U16, |i| (chance(i, 32) * 65_536.0).floor())
            .with("label", Kind::I32, |i| (i % 5) as f64 - 1.0)
            .with("warmth", Kind::F32, |i| f64::from((20.0 + 5.0 * chance(i, 33)) as f32))
    }

    /// Each point beside itself: of a ball about the origin these are its normals.
    pub(super) fn directed(mut self) -> Self {
        for (axis, name) in ["nx", "ny", "nz"].into_iter().enumerate() {
            let values = self.positions.iter().map(|position| position[axis]).collect();
            self.columns.push(Column { name, kind: Kind::F32, values });
        }
        self
    }
}

/// A number from 0 to 1 (exclusive) that is another for each row and salt: a step of SplitMix64.
fn chance(row: usize, salt: u64) -> f64 {
    let stream = salt.wrapping_mul(0xD1B5_4A32_D192_ED03);
    let mut z = (row as u64 + 1).wrapping_mul(0x9E37_79B9_7F4A_7C15) ^ stream;
    z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    ((z ^ (z >> 31)) >> 11) as f64 / (1_u64 << 53) as f64
}

/// A point of the unit circle, without sines: quarter by quarter, each by the rational parametrisation.
fn circle(turn: f64) -> [f64; 2] {
    let quarter = (4.0 * turn).floor();
    let t = 4.0 * turn - quarter;
    let [x, y] = [(1.0 - t * t) / (1.0 + t * t), 2.0 * t / (1.0 + t * t)];
    [[x, y], [-y, x], [-x, -y], [y, -x]][quarter as usize % 4]
}

/// A closed surface with a hole, as 32-bit floats have it.
pub(super) fn ring(points: usize) -> Points {
    Points::of(points, |i| {
        let [[x, y], [out, up]] = [circle(chance(i, 1)), circle(chance(i, 2))];
        let radius = 1.0 + 0.4 * out;
        [radius * x, radius * y, 0.4 * up].map(|c| f64::from(c as f32))
    })
}

/// An open sheet with some noise.
pub(super) fn hill(points: usize) -> Points {
    Points::of(points, |i| {
        let [x, y] = [2.0 * chance(i, 3) - 1.0, 2.0 * chance(i, 4) - 1.0];
        [x, y, 0.5 * (1.0 - x * x) * (1.0 - y * y) + 0.3 * x * y + 0.006 * (chance(i, 5) - 0.5)]
    })
}

/// A ball about the origin, its radius off by up to `noise`.
pub(super) fn ball(points: usize, noise: f64) -> Points {
    Points::of(points, |i| {
        let z = 1.0 - (2 * i + 1) as f64 / points as f64;
        let [x, y] = circle(chance(i, 6));
        let across = (1.0 - z * z).sqrt();
        [across * x, across * y, z].map(|c| c * (1.0 + noise * (2.0 * chance(i, 7) - 1.0)))
    })
}

/// Sharp edges: the faces of a box.
pub(super) fn chest(points: usize) -> Points {
    Points::of(points, |i| {
        let [u, v] = [2.0 * chance(i, 8) - 1.0, 2.0 * chance(i, 9) - 1.0];
        let side = if i % 2 == 0 { 1.0 } else { -1.0 };
        [[side, u, v], [u, side, v], [u, v, side]][i / 2 % 3].map(|c| f64::from(c as f32))
    })
}

/// Ground of 100 metres in a map's coordinates, in steps of a centimetre.
pub(super) fn ground(points: usize) -> Points {
    let mut ground = hill(points);
    for position in &mut ground.positions {
        let [x, y, z] = position.map(|c| (5000.0 * c).round() / 100.0);
        *position = [x + 465_123.25, y + 5_204_987.5, z + 612.0];
    }
    ground
}

/// A ring with what scans have: rows without a point, points twice, and a few far from all others.
pub(super) fn holes(points: usize) -> Points {
    let mut holes = ring(points);
    for i in 0..points {
        match i % 60 {
            7 => holes.positions[i][i % 3] = f64::NAN,
            23 => holes.positions[i] = holes.positions[i - 1],
            _ => {}
        }
    }
    holes.positions[points / 2] = [3.5, 3.0, 2.5];
    holes.positions[points / 3] = [-4.0, 0.5, 1.0];
    holes.positions[points - 1] = [0.0, 0.0, 6.0];
    holes
}

/// An even grid, in which nearly all distances are equal: `side` rows of as many points.
pub(super) fn grid(side: usize) -> Points {
    Points::of(side * side, |i| {
        let [x, y] = [(i / side) as f64 / 4.0, (i % side) as f64 / 4.0];
        [x, y, (x - 2.0) * (y - 2.0) / 8.0]
    })
}
