//! How far a work in tiles is, on a terminal.

use std::io::{self, IsTerminal};
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::time::Instant;

use densecloud_cascade::{Observer, Stage};
use densecloud_tiles::{Step, Watch};
use indicatif::{ProgressBar, ProgressStyle};

use super::events::Events;

/// Steps of a bar for each tile.
const STEPS: f64 = 1000.0;

/// A bar of tiles on standard error, if that is a terminal.
pub(super) struct TileProgress {
    bar: ProgressBar,
    state: Mutex<State>,
}

struct State {
    start: Instant,
    /// Tiles that were done before this work.
    tile: u32,
    /// The sizes after each level of the tile at hand.
    sizes: Vec<usize>,
    level: usize,
    /// Where progress is told as events, of which input, and the share that was told last.
    events: Events,
    input: PathBuf,
    told: f64,
}

impl TileProgress {
    pub(super) fn new(quiet: bool) -> Self {
        let is_shown = !quiet && io::stderr().is_terminal();
        let bar = if is_shown { ProgressBar::new(0) } else { ProgressBar::hidden() };
        let state = State {
            start: Instant::now(),
            tile: 0,
            sizes: Vec::new(),
            level: 0,
            events: Events::default(),
            input: PathBuf::new(),
            told: 0.0,
        };
        Self { bar, state: Mutex::new(state) }
    }

    /// The same, which tells events of this input.
    pub(super) fn told(self, events: Events, input: &Path) -> Self {
        self.with(|state, _| (state.events, state.input) = (events, input.to_owned()));
        self
    }

    pub(super) fn finish(&self) {
        self.bar.finish_and_clear();
    }

    fn style(&self, template: &str) {
        if let Ok(style) = ProgressStyle::with_template(template) {
            self.bar.set_style(style.progress_chars("=> "));
        }
    }

    fn with(&self, change: impl FnOnce(&mut State, &ProgressBar)) {
        if let Ok(mut state) = self.state.lock() {
            change(&mut state, &self.bar);
        }
    }
}

impl State {
    /// Shows the share of the tile that is done, by the points of its levels.
    fn show(&mut self, bar: &ProgressBar, share: f64) {
        let all = self.sizes.iter().sum::<usize>().max(1) as f64;
        let before = self.sizes.iter().take(self.level).sum::<usize>() as f64;
        let own = self.sizes.get(self.level).map_or(0.0, |size| *size as f64);
        let done = f64::from(self.tile) + (before + share * own) / all;
        bar.set_position((STEPS * done) as u64);
        let tiles = bar.length().unwrap_or_default() as f64 / STEPS;
        self.events.progress(&self.input, done / tiles.max(1.0), &mut self.told);
    }
}

impl Observer for TileProgress {
    fn plan(&self, sizes: &[usize]) {
        self.with(|state, _| (state.sizes, state.level) = (sizes.to_vec(), 0));
    }

    fn begin(&self, level: usize, stage: Stage) {
        self.with(|state, bar| {
            state.level = level;
            state.show(bar, if stage == Stage::Resample { 0.6 } else { 0.0 });
        });
    }

    fn advance(&self, done: usize, total: usize) {
        // The network takes more than half of the time.
        self.with(|state, bar| state.show(bar, 0.6 * done as f64 / total.max(1) as f64));
    }
}

impl Watch for TileProgress {
    fn step(&self, step: Step) {
        match step {
            Step::Read => self.style("{msg}"),
            Step::Cut => self.bar.set_message("cutting the cloud into tiles"),
            Step::Tile { done, of, points } => self.with(|state, bar| {
                if bar.length() != Some((STEPS * f64::from(of)) as u64) {
                    self.style("{msg:44} [{bar:30}] {percent:>3} %  {eta} left");
                    bar.set_length((STEPS * f64::from(of)) as u64);
                    bar.reset_eta();
                    state.start = Instant::now();
                }
                (state.tile, state.sizes) = (done, Vec::new());
                let rate = points as f64 / state.start.elapsed().as_secs_f64().max(1e-3);
                let rate = if points > 0 { format!(", {rate:.0} points a second") } else { String::new() };
                bar.set_message(format!("tile {} of {of}{rate}", done + 1));
                state.show(bar, 0.0);
            }),
        }
    }

    fn read(&self, points: u64) {
        self.bar.set_message(format!("{points} points read"));
    }
}
