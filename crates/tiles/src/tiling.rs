//! A plan in a folder, and how far its tiles are.

use std::thread::{self, ScopedJoinHandle};

use densecloud::Report;
use densecloud::attributes::Plan;
use densecloud::backends::ModelName;
use densecloud_cascade::{CascadeError, Whole};
use densecloud_cloud::Origin;
use densecloud_formats::{Block, Ending};
use densecloud_geometry::Partition;

use crate::input::Large;
use crate::manifest::{Causes, Manifest};
use crate::part::Elsewhere;

use crate::plan::causes;
use crate::run::Done;
use crate::{Folder, Step, TilesError, Watch, Work, origin};

/// A cloud that is cut into tiles: each can be [run](Self::run) alone, in any order and as often as one likes, by any number
/// of programs at once; then they are [joined](Self::join).
#[derive(Debug)]
pub struct Tiling {
    pub(crate) folder: Folder,
    pub(crate) manifest: Manifest,
    pub(crate) partition: Partition,
    pub(crate) whole: Whole,
    pub(crate) plan: Plan,
    /// What is told of the result, as far as it is known.
    pub(crate) report: Report,
    /// Whether the input knew more of its whole than the folder does.
    pub(crate) lost: bool,
    /// Where the parts are, if not in the folder.
    pub(crate) elsewhere: Option<Elsewhere>,
}

impl Tiling {
    pub(crate) fn of(
        folder: &Folder,
        manifest: Manifest,
        whole: Whole,
        origin: Origin,
    ) -> Result<Self, TilesError> {
        let broken = |why: &str| TilesError::broken(&folder.manifest(), why);
        let partition = manifest.partition().map_err(|why| broken(&why.to_string()))?;
        if partition.len() != manifest.tiles.len() {
            return Err(broken("it has other tiles than boxes"));
        }
        let (plan, report) = (manifest.plan(), manifest.report(origin));
        Ok(Self {
            folder: folder.clone(),
            manifest,
            partition,
            whole,
            plan,
            report,
            lost: false,
            elsewhere: None,
        })
    }

    /// What another program has planned in the folder.
    ///
    /// # Errors
    /// [`TilesError::File`], [`TilesError::Broken`].
    pub fn load(folder: &Folder) -> Result<Self, TilesError> {
        let (manifest, whole) = stored(folder)?;
        let (origin, lost) = origin::load(folder)?;
        Ok(Self { lost, ..Self::of(folder, manifest, whole, origin)? })
    }

    /// What was planned in the folder for this very work, to be gone on with ([`Folder::has_plan`]). Reads the input to its
    /// end, to know that it is the same.
    ///
    /// # Errors
    /// [`TilesError::Differs`] where it was planned for another work, and as [`Tiling::load`].
    pub fn resumed(input: Large<'_>, work: &Work<'_>, folder: &Folder) -> Result<Self, TilesError> {
        let (manifest, whole) = stored(folder)?;
        let own = causes(work, None);
        let asked = Causes { input: manifest.causes.input.clone(), ..own };
        let differs = |(what, there, here)| {
            Err(TilesError::Differs { folder: folder.path().to_owned(), what, there, here })
        };
        // Whatever the input is, before it is read.
        if let Some(other) = manifest.causes.differs(&asked) {
            return differs(other);
        }
        work.watch.step(Step::Read);
        let Ending { origin, .. } = rest(input, work.watch)?;
        if let Some(other) = manifest.causes.differs(&causes(work, origin.sha256)) {
            return differs(other);
        }
        let origin = manifest.origin(&origin);
        Self::of(folder, manifest, whole, origin)
    }

    /// Whether the input's format knows more of its whole than the folder keeps, which [`Tiling::with_input`] takes from
    /// there. Without, the result is told to have lost it.
    #[must_use]
    pub fn lacks_origin(&self) -> bool {
        self.lost
    }

    /// Reads the input once more, to its end, for what is told of its whole.
    ///
    /// # Errors
    /// [`TilesError::Broken`] where it is not the input that was planned, and as reading it.
    pub fn with_input(self, input: Large<'_>, watch: &dyn Watch) -> Result<Self, TilesError> {
        let Ending { origin, .. } = rest(input, watch)?;
        if origin.sha256.map(hex::encode) != self.manifest.causes.input {
            return Err(TilesError::broken(&self.folder.manifest(), "it is of another input"));
        }
        let report = self.manifest.report(self.manifest.origin(&origin));
        Ok(Self { report, lost: false, ..self })
    }

    /// Checks that it was planned by this version of the program, for that model: parts of others would not fit.
    ///
    /// # Errors
    /// [`TilesError::Differs`].
    pub fn check(&self, model: &ModelName) -> Result<(), TilesError> {
        let causes = &self.manifest.causes;
        let own = Causes {
            version: env!("CARGO_PKG_VERSION").to_owned(),
            model: [model.name.clone(), model.sha256.clone()],
            ..causes.clone()
        };
        causes.differs(&own).map_or(Ok(()), |(what, there, here)| {
            Err(TilesError::Differs { folder: self.folder.path().to_owned(), what, there, here })
        })
    }

    /// How many tiles there are.
    #[must_use]
    #[expect(clippy::len_without_is_empty, reason = "there is always one")]
    pub fn len(&self) -> u32 {
        self.manifest.tiles.len() as u32
    }

    /// What is told of the result before the work.
    #[must_use]
    pub fn report(&self) -> &Report {
        &self.report
    }

    /// Points of the input, of each tile's own and around it, and of the result.
    #[must_use]
    pub fn points(&self, tile: u32) -> [u64; 3] {
        let tile = self.manifest.tiles[tile as usize];
        [tile.own, tile.around, tile.size]
    }

    /// Bytes that each point of the result takes beside its position, about.
    #[must_use]
    pub fn attribute_bytes(&self) -> u64 {
        let mut attributes = self.manifest.attributes();
        self.manifest.adaptation().apply(&mut attributes);
        self.manifest.causes.options.finish.bytes_a_point(&attributes)
    }

    /// Bytes of the disk that the work takes until it is over, about: the points of tiles, and their parts.
    #[must_use]
    pub fn disk_bytes(&self) -> u64 {
        let own = crate::plan::BARE + densecloud_cloud::bytes_a_point(&self.manifest.attributes());
        let read: u64 = self.manifest.tiles.iter().map(|tile| tile.own + tile.around).sum();
        let made = size_of::<densecloud_cloud::Position>() as u64 + self.attribute_bytes();
        read.saturating_mul(own).saturating_add(self.report.points_out.saturating_mul(made))
    }

    /// What is known of a tile that is done; none where it is not.
    pub(crate) fn done(&self, tile: u32) -> Result<Option<Done>, TilesError> {
        let path = self.folder.done(tile);
        match std::fs::read(&path) {
            Ok(bytes) => serde_json::from_slice(&bytes)
                .map(Some)
                .map_err(|why| TilesError::broken(&path, why.to_string())),
            Err(why) if why.kind() == std::io::ErrorKind::NotFound => Ok(None),
            Err(why) => Err(TilesError::File { path, why }),
        }
    }

    /// The numbers of the tiles that are not done.
    ///
    /// # Errors
    /// [`TilesError::File`], [`TilesError::Broken`].
    pub fn not_done(&self) -> Result<Vec<u32>, TilesError> {
        let mut left = Vec::new();
        for tile in 0..self.len() {
            left.extend(self.done(tile)?.is_none().then_some(tile));
        }
        Ok(left)
    }

    /// Runs all tiles that are not done.
    ///
    /// # Errors
    /// As [`Tiling::run`]; the others' parts stay.
    pub fn run_all(&self, work: &Work<'_>) -> Result<(), TilesError> {
        self.run_each(work, || true)
    }

    /// The same; `done` hears of each tile that is, and ends it by saying no, within one more tile.
    ///
    /// A part is written while the next tile is worked on: the disk holds up no work. At most one waits for that.
    pub(crate) fn run_each(&self, work: &Work<'_>, done: impl Fn() -> bool + Sync) -> Result<(), TilesError> {
        let (tell, mut made) = (&done, 0);
        thread::scope(|scope| {
            let mut writing: Option<Writing<'_>> = None;
            for tile in 0..self.len() {
                if work.watch.cancelled() {
                    return Err(CascadeError::Cancelled.into());
                }
                let done = self.done(tile)?;
                work.watch.step(Step::Tile { done: tile, of: self.len(), points: made });
                let part = match &done {
                    Some(_) => None,
                    None => Some(self.made_of(tile, work.runner, work.watch)?),
                };
                made += part.as_ref().map(|part| &part.done).or(done.as_ref()).map_or(0, |done| done.points);
                if !went_on(writing.take())? {
                    return Ok(());
                }
                writing = Some(scope.spawn(move || {
                    part.map_or(Ok(()), |part| self.write(tile, part))?;
                    Ok(tell())
                }));
            }
            went_on(writing).map(drop)
        })
    }
}

/// A part on its way to the disk: whether more are wanted.
type Writing<'scope> = ScopedJoinHandle<'scope, Result<bool, TilesError>>;

/// Waits for a part, if there is one.
fn went_on(writing: Option<Writing<'_>>) -> Result<bool, TilesError> {
    let wait = |writing: Writing<'_>| writing.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic));
    writing.map_or(Ok(true), wait)
}

fn stored(folder: &Folder) -> Result<(Manifest, Whole), TilesError> {
    let path = folder.manifest();
    let bytes = std::fs::read(&path).map_err(TilesError::file(&path))?;
    let manifest: Manifest =
        serde_json::from_slice(&bytes).map_err(|why| TilesError::broken(&path, why.to_string()))?;
    let path = folder.whole();
    let bytes = std::fs::read(&path).map_err(TilesError::file(&path))?;
    let whole = Whole::from_bytes(&bytes).map_err(|why| TilesError::broken(&path, why.to_string()))?;
    Ok((manifest, whole))
}

/// Reads a cloud to its end for what is told there.
fn rest(input: Large<'_>, watch: &dyn Watch) -> Result<Ending, TilesError> {
    let Large { mut reader, first, .. } = input;
    let mut points = first.iter().map(|block| block.positions.len() as u64).sum();
    drop(first);
    let mut block = Block::default();
    while reader.next_block(crate::chunk::ROWS, &mut block)? {
        points += block.positions.len() as u64;
        watch.read(points);
        if watch.cancelled() {
            return Err(CascadeError::Cancelled.into());
        }
    }
    Ok(reader.finish()?)
}
