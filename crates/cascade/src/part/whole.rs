//! What a part has to know of the whole.

use std::sync::Arc;

use super::field::Field;
use crate::globals::{Globals, LevelGlobals, PolishGlobals};
use crate::input::{Input, distinct, local};
use crate::level::Run;
use crate::plan::Choice;
use crate::{CascadeError, CascadeOptions, LevelRunner, Observer, Target, cascade};
use densecloud_cloud::{Frame, Point, Position};

/// What is known of a whole cloud: enough to work on a part of it. [`Whole::to_bytes`] hands it on.
#[derive(Debug, Clone, PartialEq)]
pub struct Whole {
    bounds: [Position; 2],
    ratio: f64,
    globals: Globals,
}

/// Bytes that are no [`Whole`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("these bytes do not tell of a whole cloud")]
pub struct WholeError;

/// What a survey looks at.
#[derive(Debug, Clone, Copy)]
pub struct Survey<'a> {
    /// The lowest and the highest finite coordinates of the whole.
    pub bounds: [Position; 2],
    /// Finite points of the whole.
    pub finite: u64,
    /// Finite points spread over the whole, each as likely as the others: some hundred thousand.
    pub sample: &'a [Position],
    /// Finite points that are all of some places, far from each other: some ten thousand of each.
    pub places: &'a [Position],
    /// Points of the result for each finite point.
    pub ratio: f64,
}

impl Whole {
    /// Learns what parts have to know: from a sample how dense the whole is where, and from some places, which are upsampled,
    /// how even and how clean it is. The same survey gives the same result on any number of threads.
    ///
    /// Cost: that of upsampling the places, and a tree of the sample.
    ///
    /// # Errors
    /// As [`upsample`](crate::upsample), for the places.
    pub fn survey(
        survey: &Survey<'_>,
        options: &CascadeOptions,
        runner: &dyn LevelRunner,
        observer: &dyn Observer,
    ) -> Result<Self, CascadeError> {
        options.check()?;
        let frame = Frame::fit(&survey.bounds)?;
        let [sample, points] = [survey.sample, survey.places].map(|of| distinct(&local(of, frame)));
        let finite = points.len();
        let input = Input { frame, points, finite, non_finite: 0 };
        let mut globals = Globals::new(frame);
        let run = Run { options, runner, observer, part: None };
        let among = if options.polish { Choice::Polished } else { Choice::MadeInside };
        cascade(input, (Target::Ratio(survey.ratio), among), &run, &mut globals)?;
        if let Some((field, usual)) = Field::of(&sample)? {
            let usual = usual - (survey.finite as f32 / sample.len() as f32).ln();
            let more = usual - globals.usual_point.unwrap_or(usual);
            globals.usual_point = Some(usual);
            globals.polish.usual_point = globals.polish.usual_point.map(|there| there + more);
            globals.field = Some(Arc::new(field));
        }
        // These are a part's own.
        globals.sizes.clear();
        globals.polish.midpoints = None;
        Ok(Self { bounds: survey.bounds, ratio: survey.ratio, globals })
    }

    pub(super) fn globals(&self) -> &Globals {
        &self.globals
    }

    pub(super) fn levels(&self) -> usize {
        self.globals.levels.len()
    }

    pub(super) fn ratio(&self) -> f64 {
        self.ratio
    }

    /// For [`Whole::from_bytes`], which gives the same value back, to the last bit.
    #[must_use]
    pub fn to_bytes(&self) -> Vec<u8> {
        let Globals { usual_spacings, evenness, usual_point, field, levels, polish, .. } = &self.globals;
        let mut bytes = MARK.to_vec();
        let numbers = self.bounds.as_flattened().iter().chain([&self.ratio]);
        numbers.for_each(|n| bytes.extend(n.to_le_bytes()));
        let PolishGlobals {
            trust,
            input_a_sample,
            midpoints: _,
            usual_point: there,
            usual_area,
            usual_density,
        } = polish;
        let polish = [trust, input_a_sample, there, usual_area, usual_density];
        let options = usual_spacings.iter().chain([evenness, usual_point]).chain(polish);
        options.for_each(|n| put(&mut bytes, *n));
        bytes.extend((levels.len() as u32).to_le_bytes());
        for level in levels {
            put(&mut bytes, level.usual_distance);
            put(&mut bytes, level.most_strayed);
        }
        let (points, relative) = field.as_ref().map_or((&[][..], &[][..]), |field| field.parts());
        bytes.extend((points.len() as u32).to_le_bytes());
        let numbers = points.as_flattened().iter().chain(relative);
        numbers.for_each(|n| bytes.extend(n.to_le_bytes()));
        bytes
    }

    /// What [`Whole::to_bytes`] wrote.
    ///
    /// # Errors
    /// The bytes are others.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, WholeError> {
        let mut bytes = Bytes(bytes);
        if bytes.take()? != *MARK {
            return Err(WholeError);
        }
        let mut bounds = [[0.0; 3]; 2];
        for number in bounds.as_flattened_mut() {
            *number = f64::from_le_bytes(bytes.take()?);
        }
        let ratio = f64::from_le_bytes(bytes.take()?);
        let mut globals = Globals::new(Frame::fit(&bounds).map_err(|_| WholeError)?);
        for spacing in &mut globals.usual_spacings {
            *spacing = bytes.option()?;
        }
        globals.evenness = bytes.option()?;
        globals.usual_point = bytes.option()?;
        let polish = &mut globals.polish;
        for number in [
            &mut polish.trust,
            &mut polish.input_a_sample,
            &mut polish.usual_point,
            &mut polish.usual_area,
            &mut polish.usual_density,
        ] {
            *number = bytes.option()?;
        }
        for _ in 0..bytes.count()? {
            let (usual_distance, most_strayed) = (bytes.option()?, bytes.option()?);
            globals.levels.push(LevelGlobals { usual_distance, most_strayed });
        }
        let count = bytes.count()?;
        let mut number = || bytes.take().map(f32::from_le_bytes);
        let points: Vec<Point> =
            (0..count).map(|_| Ok([number()?, number()?, number()?])).collect::<Result<_, _>>()?;
        let relative: Vec<f32> = (0..count).map(|_| number()).collect::<Result<_, _>>()?;
        let is_finite = points.as_flattened().iter().chain(&relative).all(|n| n.is_finite());
        if !bytes.0.is_empty() || !is_finite || globals.levels.is_empty() || !(1.0..=64.0).contains(&ratio) {
            return Err(WholeError);
        }
        globals.field = (count > 0).then(|| Arc::new(Field::from_parts(points, relative)));
        Ok(Self { bounds, ratio, globals })
    }
}

/// What the bytes begin with: a version of their layout.
const MARK: &[u8; 8] = b"whole  1";

fn put(bytes: &mut Vec<u8>, number: Option<f32>) {
    bytes.push(u8::from(number.is_some()));
    bytes.extend(number.unwrap_or_default().to_le_bytes());
}

/// Bytes that are left to read.
struct Bytes<'a>(&'a [u8]);

impl Bytes<'_> {
    fn take<const N: usize>(&mut self) -> Result<[u8; N], WholeError> {
        let (taken, left) = self.0.split_first_chunk::<N>().ok_or(WholeError)?;
        self.0 = left;
        Ok(*taken)
    }

    fn option(&mut self) -> Result<Option<f32>, WholeError> {
        let [is_there] = self.take()?;
        let number = f32::from_le_bytes(self.take()?);
        Ok((is_there != 0).then_some(number))
    }

    fn count(&mut self) -> Result<usize, WholeError> {
        Ok(u32::from_le_bytes(self.take()?) as usize)
    }
}
