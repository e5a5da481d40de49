//! A request on its way to the engine: whose it is, until when, and what is reserved for it.

use std::sync::Arc;

use axum::http::HeaderMap;

use crate::admission::deadline::Deadline;
use crate::app::App;
use crate::problem::Problem;
use densecloud::Request;
use densecloud_engine::{Caller, Client, Cost, EngineError, Pending, Permit};

/// What every request for work carries, whichever interface it came by: make one when its head is there, tell
/// it the size as soon as that is known, and give it to [`crate::http::upsample::run`].
pub(crate) struct Ticket {
    app: Arc<App>,
    caller: Caller,
    pub(crate) deadline: Deadline,
    reserved: Option<Permit>,
}

impl Ticket {
    /// For a request of this client.
    ///
    /// # Errors
    /// What [`Deadline::of`] gives.
    pub(crate) fn new(app: &Arc<App>, client: Client, headers: &HeaderMap) -> Result<Self, Problem> {
        let deadline = Deadline::of(headers, app.config.timeouts.request)?;
        Ok(Self::until(app, client, deadline))
    }

    /// As [`Ticket::new`], with a deadline that came in another way.
    pub(crate) fn until(app: &Arc<App>, client: Client, deadline: Deadline) -> Self {
        let caller = Caller { client, deadline: deadline.at() };
        Self { app: Arc::clone(app), caller, deadline, reserved: None }
    }

    /// Whose it is.
    pub(crate) fn client(&self) -> &Client {
        &self.caller.client
    }

    /// Refuses at once where not even one point could be taken: before anything of the body is read.
    ///
    /// # Errors
    /// Not ready, or the engine's.
    pub(crate) fn check(&self) -> Result<(), Problem> {
        self.app.readiness.check()?;
        let least = Cost::new(1, 1);
        self.app.engine.would_admit(&self.caller, least).map_err(|error| self.refused(error))
    }

    /// Reserves the points of a request as soon as its size is known; again where more is known.
    ///
    /// # Errors
    /// Above a limit, or the engine's.
    pub(crate) fn reserve(&mut self, cost: Cost) -> Result<(), Problem> {
        self.app.check_points(cost.points_in, cost.points_out)?;
        if self.reserved.is_none() {
            let permit = self.app.engine.reserve(&self.caller, cost);
            self.reserved = Some(permit.map_err(|error| self.refused(error))?);
            self.app.metrics.admitted();
        }
        Ok(())
    }

    /// Reserves what a request takes that has arrived, and whose size only reading it will tell, by a guess of its points.
    /// Without effect where something is reserved, or where the guess is above what is ever taken: it may be wrong.
    ///
    /// # Errors
    /// The engine's, of which all say when to come again.
    pub(crate) fn guess(&mut self, cost: Cost) -> Result<(), Problem> {
        let limits = &self.app.config.limits;
        let known = self.reserved.is_some() || self.app.engine.check_memory(cost).is_err();
        if known || cost.points_in > limits.points_in || cost.points_out > limits.points_out {
            return Ok(());
        }
        self.reserve(cost)
    }

    /// All of the request is there; it waits to be read.
    pub(crate) fn arrived(&self) {
        if let Some(permit) = &self.reserved {
            permit.arrived();
        }
    }

    /// Queues the work. Blocks for O(points in).
    ///
    /// # Errors
    /// The engine's.
    pub(crate) fn submit(mut self, request: Request) -> Result<Pending, Problem> {
        let reserved = self.reserved.take();
        let known = reserved.is_some();
        let job = self.app.engine.submit_for(&self.caller, request, reserved);
        let job = job.map_err(|error| self.refused(error))?;
        if !known {
            self.app.metrics.admitted();
        }
        self.deadline.queued(job.progress_handle());
        Ok(job)
    }

    /// Gives what is reserved to work that is done in parts; where nothing is, so much.
    ///
    /// # Errors
    /// As [`Ticket::reserve`].
    pub(crate) fn into_parts(mut self, cost: Cost) -> Result<(Caller, Deadline, Permit), Problem> {
        self.reserve(cost)?;
        let Self { caller, deadline, reserved, .. } = self;
        let permit = reserved.ok_or_else(|| Problem::Internal("nothing is reserved".into()))?;
        Ok((caller, deadline, permit))
    }

    fn refused(&self, error: impl Into<EngineError>) -> Problem {
        let problem = Problem::from_engine(error.into());
        self.app.metrics.refused(problem.outcome());
        problem
    }
}
