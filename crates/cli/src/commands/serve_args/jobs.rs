//! Options of jobs: where they are kept, and how many.

use std::path::PathBuf;
use std::time::{Duration, SystemTime};

use clap::Args;
use densecloud_backends::Model;
use densecloud_jobs::{Keeping, Password, Settings};

use super::super::CliError;
use super::seconds;

/// Jobs: work that outlives requests, and the server.
#[derive(Debug, Args)]
pub(super) struct JobsArgs {
    /// Folder in which jobs are kept; without it there are none
    #[arg(long, env = "DENSECLOUD_DATA_DIR", value_name = "DIR")]
    data_dir: Option<PathBuf>,

    /// Database that servers and workers share instead of a folder, such as postgres://user@host/name
    #[arg(long, env = "DENSECLOUD_DATABASE", value_name = "ADDRESS")]
    database: Option<String>,

    /// File whose first line is its password, and that not everybody can read; without it the password is in PGPASSWORD or
    /// PGPASSFILE
    #[arg(long, env = "DENSECLOUD_DATABASE_PASSWORD_FILE", value_name = "FILE")]
    database_password_file: Option<PathBuf>,

    /// Store that they share for clouds and results, such as s3://bucket/prefix, or a folder that all of them see; what it
    /// takes to reach it is in AWS_ACCESS_KEY_ID and the like
    #[arg(long, env = "DENSECLOUD_STORE", value_name = "ADDRESS")]
    store: Option<String>,

    /// How long a worker may be silent before its step of a job is given to another; with --database
    #[arg(long, env = "DENSECLOUD_JOB_LEASE", value_name = "SECONDS", value_parser = seconds,
        default_value = "30")]
    job_lease: Duration,

    /// Steps of jobs that run here at a time; 0 where others work on them
    #[arg(long, env = "DENSECLOUD_JOBS_RUNNING", value_name = "N", default_value_t = 1)]
    jobs_running: usize,

    /// How long a job is kept when it has come to its end, with its result
    #[arg(long, env = "DENSECLOUD_JOB_EXPIRY", value_name = "SECONDS", value_parser = seconds,
        default_value = "86400")]
    job_expiry: Duration,

    /// Bytes of the disk that all jobs may take: clouds until they are done, results after
    #[arg(long, env = "DENSECLOUD_JOB_DISK", value_name = "N", default_value_t = 10 << 30)]
    job_disk: u64,

    /// Jobs that may be queued or running
    #[arg(long, env = "DENSECLOUD_MAX_JOBS", value_name = "N", default_value_t = 1000)]
    max_jobs: u64,

    /// The same of one client
    #[arg(long, env = "DENSECLOUD_CLIENT_JOBS", value_name = "N", default_value_t = 100)]
    client_jobs: u64,

    /// How often a job is started, when the server ends under it, before it counts as failed
    #[arg(long, env = "DENSECLOUD_JOB_ATTEMPTS", value_name = "N", default_value_t = 3)]
    job_attempts: u32,
}

impl JobsArgs {
    /// What this process shares with others.
    fn shared(&self, database: &str, store: &str, model: &Model) -> Result<Keeping, CliError> {
        let host = gethostname::gethostname();
        // A container's first process always has the same number.
        let started = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default();
        let name = model.name();
        Ok(Keeping::Shared {
            database: database.to_owned(),
            password: self.password()?,
            store: store.to_owned(),
            process: format!("{}, process {}, {:x}", host.display(), std::process::id(), started.as_millis()),
            kind: format!("{}, {} {}, {}", env!("CARGO_PKG_VERSION"), name.name, name.sha256, processor()),
        })
    }

    /// The database's password, where a file has it.
    fn password(&self) -> Result<Option<Password>, CliError> {
        let Some(path) = &self.database_password_file else { return Ok(None) };
        let wrong = |error| CliError::Usage(format!("--database-password-file {}: {error}", path.display()));
        Password::from_file(path).map(Some).map_err(wrong)
    }

    /// How jobs are kept, if they are.
    pub(super) fn settings(&self, model: &Model) -> Result<Option<Settings>, CliError> {
        let keeping = match (&self.data_dir, &self.database, &self.store) {
            (_, None, _) if self.database_password_file.is_some() => {
                return Err(CliError::Usage("--database-password-file also needs --database".into()));
            }
            (None, None, None) => return Ok(None),
            (Some(folder), None, None) => Keeping::Folder(folder.clone()),
            (None, Some(database), Some(store)) => self.shared(database, store, model)?,
            (Some(_), ..) => {
                let why = "--data-dir is for one server alone; --database and --store are instead of it";
                return Err(CliError::Usage(why.into()));
            }
            (None, Some(_), None) => return Err(CliError::Usage("--database also needs --store".into())),
            (None, None, Some(_)) => return Err(CliError::Usage("--store also needs --database".into())),
        };
        let lease = if let Keeping::Shared { .. } = keeping { self.job_lease } else { Settings::LEASE_ALONE };
        Ok(Some(Settings {
            keeping,
            running: self.jobs_running,
            lease,
            expiry: self.job_expiry,
            disk: self.job_disk,
            queued: self.max_jobs,
            client_queued: self.client_jobs,
            attempts: self.job_attempts,
        }))
    }
}

/// The kind of this machine's processor, as far as results depend on it: with AVX2 sums go in another order than without,
/// and with AVX-512 in the same.
fn processor() -> &'static str {
    #[cfg(target_arch = "x86_64")]
    if std::arch::is_x86_feature_detected!("avx2") && std::arch::is_x86_feature_detected!("fma") {
        return "x86_64 with AVX2";
    }
    std::env::consts::ARCH
}
