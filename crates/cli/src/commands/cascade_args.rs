//! Options of the cascade itself, of every command that runs it here.

use clap::Args;

use densecloud_cascade::CascadeOptions;

/// How the cascade is run.
#[derive(Debug, Clone, Args)]
pub(super) struct CascadeArgs {
    /// How many patches each point lies in, on average: more is slower
    #[arg(long, value_name = "X", default_value_t = CascadeOptions::default().overlap)]
    pub(super) overlap: f64,

    /// Share of each patch, around its centre, whose points are kept: 1 keeps all
    #[arg(long, value_name = "X", default_value_t = CascadeOptions::default().inner)]
    pub(super) inner: f64,

    /// Leave out points moved further than this many spacings from their source; `inf` keeps all
    #[arg(long, value_name = "X", default_value_t = CascadeOptions::default().max_displacement)]
    pub(super) max_displacement: f64,

    /// Leave out points further from the input than this many times what nine in ten keep to, and points beyond its
    /// open borders; `inf` keeps all
    #[arg(long, value_name = "X", default_value_t = CascadeOptions::default().max_distance)]
    pub(super) max_distance: f64,

    /// Keep what the network made as it is: less even, less smooth, and each point an output of the network
    #[arg(long)]
    pub(super) no_polish: bool,
}

impl CascadeArgs {
    /// All of them, for what leaves them without a meaning.
    pub(super) const ALL: [&str; 5] = ["overlap", "inner", "max_displacement", "max_distance", "no_polish"];

    pub(super) fn settings(&self, seed: u64) -> CascadeOptions {
        let Self { overlap, inner, max_displacement, max_distance, no_polish } = *self;
        CascadeOptions { overlap, inner, max_displacement, max_distance, polish: !no_polish, seed }
    }
}
