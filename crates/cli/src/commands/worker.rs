//! `densecloud worker`: works on jobs that servers take.

use clap::Args;

use super::serve_args::ServeArgs;

/// Work on the jobs that servers take, beside any number of other workers.
///
/// It has the settings of `serve`, of which those of requests have no effect, and answers only /healthz, /readyz and
/// /metrics.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  export DENSECLOUD_DATABASE=postgres://densecloud@db/densecloud DENSECLOUD_STORE=s3://clouds/jobs
  densecloud serve --jobs-running 0 --host 0.0.0.0 --port 8080
  densecloud worker --port 8081

SIGTERM and SIGINT have it put back the steps that it is at; a second one ends it at once.")]
pub(super) struct WorkerArgs {
    #[command(flatten)]
    pub(super) args: ServeArgs,
}
