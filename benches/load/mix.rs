//! The requests of a load: mostly small clouds, a few large ones, 4x; and what their answers must be.

use std::collections::HashMap;
use std::hash::{BuildHasher, BuildHasherDefault, DefaultHasher};
use std::sync::{Arc, Mutex};

use densecloud_cloud::Origin;
use densecloud_formats::{CloudReader, Format, Limits, PlyEncoding, Scalar, encode};
use densecloud_geometry::{Rng, shape, uniform};
use hyper::body::Bytes;

pub(crate) const RATIO: u64 = 4;
pub(crate) const TARGET: &str = "/upsample?ratio=4";

/// A request for one cloud.
#[derive(Clone)]
pub(crate) struct Order {
    pub(crate) number: usize,
    pub(crate) body: Bytes,
    /// Points in the answer.
    pub(crate) points_out: u64,
}

/// Clouds made beforehand, and the answers to them.
pub(crate) struct Mix {
    /// Clouds of each class, and how many of [`DECK`] requests are of it.
    classes: Vec<(u64, Vec<Order>)>,
    /// Hash of the first answer to each, which was parsed.
    answers: Mutex<HashMap<usize, (usize, u64)>>,
}

/// Requests after which each class has had its share.
const DECK: u64 = 20;

/// How many of a deck, and the clouds' points.
const CLASSES: [(u64, [u64; 4]); 3] =
    [(14, [1000, 1300, 1600, 2000]), (5, [5000, 6500, 8000, 10_000]), (1, [30_000, 36_000, 42_000, 50_000])];

/// Requests in random order, with each class's share exact every [`DECK`] requests: large clouds are rare and most of
/// the work, so that plain chance would make one load heavier than the next.
pub(crate) struct Deck {
    mix: Arc<Mix>,
    random: Rng,
    left: Vec<usize>,
}

impl Deck {
    pub(crate) fn new(mix: &Arc<Mix>, random: Rng) -> Self {
        Self { mix: Arc::clone(mix), random, left: Vec::new() }
    }

    pub(crate) fn draw(&mut self) -> Order {
        if self.left.is_empty() {
            let classes = CLASSES.iter().enumerate();
            self.left = classes.flat_map(|(class, (share, _))| vec![class; *share as usize]).collect();
        }
        let place = self.random.below(self.left.len() as u64) as usize;
        self.mix.draw(self.left.swap_remove(place), &mut self.random)
    }
}

impl Mix {
    pub(crate) fn new() -> Self {
        let mesh = shape("knot").expect("a built-in shape");
        let format = Format::Ply { encoding: PlyEncoding::BinaryLittleEndian, scalar: Scalar::F32 };
        let mut number = 0;
        let classes = CLASSES.map(|(share, sizes)| {
            let orders = sizes.map(|points| {
                let cloud = uniform(&mesh, points as usize, number as u64).unwrap();
                let body = encode(Vec::new(), format, &cloud, &[], &Origin::default()).unwrap().into();
                number += 1;
                Order { number: number - 1, body, points_out: RATIO * points }
            });
            (share, orders.to_vec())
        });
        Self { classes: classes.to_vec(), answers: Mutex::default() }
    }

    /// Mean points in an answer.
    pub(crate) fn points(&self) -> f64 {
        let shares = self.classes.iter().enumerate();
        shares.map(|(class, (share, _))| *share as f64 * self.points_of(class)).sum::<f64>() / DECK as f64
    }

    /// Mean points in the answers to a class.
    pub(crate) fn points_of(&self, class: usize) -> f64 {
        let orders = &self.classes[class].1;
        orders.iter().map(|order| order.points_out).sum::<u64>() as f64 / orders.len() as f64
    }

    /// A cloud of a class; the small ones are class 0.
    pub(crate) fn draw(&self, class: usize, random: &mut Rng) -> Order {
        let orders = &self.classes[class].1;
        orders[random.below(orders.len() as u64) as usize].clone()
    }

    /// Whether this is the whole answer to that request. The same request has the same bytes every time.
    pub(crate) fn check(&self, order: &Order, bytes: &[u8]) -> Result<(), String> {
        let found = (bytes.len(), BuildHasherDefault::<DefaultHasher>::default().hash_one(bytes));
        let mut answers = self.answers.lock().unwrap();
        if let Some(known) = answers.get(&order.number) {
            return if *known == found { Ok(()) } else { Err("an answer is not like the first".into()) };
        }
        let cloud = CloudReader::open(bytes, Limits::default()).and_then(CloudReader::read);
        let cloud = cloud.map_err(|error| format!("an answer cannot be read: {error}"))?;
        let finite = cloud.positions.iter().filter(|p| p.iter().all(|c| c.is_finite())).count() as u64;
        if finite != order.points_out {
            return Err(format!("an answer has {finite} points, not {}", order.points_out));
        }
        answers.insert(order.number, found);
        Ok(())
    }
}
