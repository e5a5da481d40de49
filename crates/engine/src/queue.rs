//! The queue: bounded in points, for all and for each client; fair among clients in each lane; no more at
//! work than memory allows.

use std::collections::HashMap;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use super::client::{Caller, Client};
use super::clock::Clock;
use super::coming::{Coming, Expected};
use super::cost::{Cost, Pace};
use super::fair::Fair;
use super::pending::Task;
use super::refusal::Refusal;
use super::workers::Lane;
use densecloud_cascade::Demand;

/// What a queue may hold.
#[derive(Debug, Clone, Copy)]
pub(super) struct Bounds {
    /// Points out of all requests.
    pub(super) points: u64,
    /// Points out of one client's.
    pub(super) client_points: u64,
    /// The longest that the work waiting in a lane may take; above it no more is admitted. None is no limit.
    pub(super) time: Option<Duration>,
    /// Bytes that all requests at work may take.
    pub(super) memory: u64,
    /// Threads that take requests of either lane, and as many more that take small ones.
    pub(super) threads: usize,
}

/// Tasks that wait, and the account of all that was admitted.
pub(super) struct Queue {
    bounds: Bounds,
    demand: Demand,
    clock: Arc<dyn Clock>,
    state: Mutex<State>,
    // Wakes the queue's threads; a channel would not let a caller take its task back out.
    changed: Condvar,
}

struct State {
    /// By lane.
    waiting: [Fair<Arc<Task>>; 2],
    /// What will wait there.
    coming: Coming,
    points: u64,
    /// What each client has admitted, by lane; no entry is nothing.
    clients: HashMap<Client, [Load; 2]>,
    running: Vec<Running>,
    next_number: u64,
    shared: SharedTime,
    pace: Pace,
    closed: bool,
}

/// What is admitted.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
struct Load {
    requests: u64,
    points: u64,
    /// Microseconds, whole ones, so that sums come back to nothing.
    time: u64,
}

/// One task at work.
struct Running {
    number: u64,
    client: Client,
    lane: Lane,
    memory: u64,
    time: u64,
    since: Duration,
}

/// Time that goes slower the more tasks are at work: with three of them at a third of the pace. So a task takes by it what
/// it would take alone.
#[derive(Debug, Clone, Copy, Default)]
struct SharedTime {
    time: Duration,
    looked: Option<Instant>,
}

impl SharedTime {
    fn advance(&mut self, running: usize, now: Instant) {
        if let Some(looked) = self.looked.replace(now) {
            self.time += (now - looked) / running.max(1) as u32;
        }
    }
}

/// Points of the queue's budget, and of its client's share. Dropping it, wherever the work ends, gives them back.
#[must_use = "dropping a permit gives its points back"]
pub struct Permit {
    queue: Arc<Queue>,
    client: Client,
    cost: Cost,
    time: u64,
    /// Its name in [`State::coming`].
    number: u64,
}

impl Permit {
    /// What it was taken for.
    #[must_use]
    pub fn cost(&self) -> Cost {
        self.cost
    }

    /// How long the work will take, alone on the machine.
    fn estimate(&self) -> Duration {
        Duration::from_micros(self.time)
    }

    /// Takes a part of it away, for work that is done one part after another: both together are what it was, and this is
    /// what is left of it. It waits no more for its work to begin.
    pub fn part(&mut self, cost: Cost) -> Self {
        let queue = Arc::clone(&self.queue);
        let mut state = queue.lock();
        state.coming.remove(self.number);
        state.give_back(&self.client, self.cost, self.time);
        let (cost, rest) = self.cost.split(cost);
        (self.cost, self.time) = (rest, state.time(rest));
        state.take(&self.client, self.cost, self.time);
        let time = state.time(cost);
        state.take(&self.client, cost, time);
        let (number, client) = (state.number(), self.client.clone());
        Self { queue: Arc::clone(&queue), client, cost, time, number }
    }

    /// Tells that all of the request is there, but for being read: from now on it counts as waiting, however long that
    /// takes.
    pub fn arrived(&self) {
        self.queue.lock().coming.arrived(self.number);
    }

    pub(super) fn number(&self) -> u64 {
        self.number
    }

    /// Changes its size, now that more is known: to a smaller one always, to a larger one where there is room.
    ///
    /// # Errors
    /// As [`super::Engine::reserve`]; it is as before then.
    pub(super) fn resize(&mut self, caller: &Caller, cost: Cost) -> Result<(), Refusal> {
        if cost == self.cost {
            return Ok(());
        }
        let queue = Arc::clone(&self.queue);
        let mut state = queue.lock();
        state.give_back(&self.client, self.cost, self.time);
        // It does not wait for itself.
        let expected = state.coming.remove(self.number);
        // What has been let in may stay where it does not ask for more.
        let checked = if cost.points_out > self.cost.points_out {
            queue.check(&mut state, caller, cost)
        } else {
            queue.check_memory(cost)
        };
        if checked.is_ok() {
            (self.cost, self.time) = (cost, state.time(cost));
        }
        state.take(&self.client, self.cost, self.time);
        if let Some(expected) = expected {
            let (lane, time) = (self.cost.lane(), self.estimate());
            state.coming.add(Expected { lane, time, ..expected });
        }
        checked
    }
}

impl Drop for Permit {
    fn drop(&mut self) {
        let mut state = self.queue.lock();
        state.coming.remove(self.number);
        state.give_back(&self.client, self.cost, self.time);
    }
}

/// A task at work, until dropped.
pub(super) struct Turn<'a> {
    queue: &'a Queue,
    number: u64,
}

impl Turn<'_> {
    /// Learns from what work of this cost took, as if alone.
    pub(super) fn learn(&self, cost: Cost, took: Duration) {
        self.queue.lock().pace.learn(cost, took);
    }

    /// How long it has been at work, as if alone on the machine.
    pub(super) fn took(&self) -> Duration {
        let mut state = self.queue.lock();
        state.look(self.queue.clock.now());
        let since = state.running.iter().find(|r| r.number == self.number).map(|r| r.since);
        state.shared.time.saturating_sub(since.unwrap_or(state.shared.time))
    }
}

impl Drop for Turn<'_> {
    fn drop(&mut self) {
        let mut state = self.queue.lock();
        state.look(self.queue.clock.now());
        state.running.retain(|r| r.number != self.number);
        drop(state);
        // Its memory is free: for a task of either lane.
        self.queue.changed.notify_all();
    }
}

impl State {
    fn look(&mut self, now: Instant) {
        self.shared.advance(self.running.len(), now);
    }

    fn time(&self, cost: Cost) -> u64 {
        self.pace.estimate(cost).as_micros().try_into().unwrap_or(u64::MAX)
    }

    fn take(&mut self, client: &Client, cost: Cost, time: u64) {
        self.points += cost.points_out;
        let load = &mut self.clients.entry(client.clone()).or_default()[cost.lane() as usize];
        load.requests += 1;
        load.points += cost.points_out;
        load.time = load.time.saturating_add(time);
    }

    fn give_back(&mut self, client: &Client, cost: Cost, time: u64) {
        self.points -= cost.points_out;
        let Some(loads) = self.clients.get_mut(client) else { return };
        let load = &mut loads[cost.lane() as usize];
        load.requests -= 1;
        load.points -= cost.points_out;
        load.time = load.time.saturating_sub(time);
        if *loads == [Load::default(); 2] {
            self.clients.remove(client);
        }
    }

    fn points_of(&self, client: &Client) -> u64 {
        self.clients.get(client).map_or(0, |loads| loads.iter().map(|load| load.points).sum())
    }

    /// Microseconds of admitted work that are left in `lane`: the client's, or all for `None`.
    fn left(&self, client: Option<&Client>, lane: Lane) -> u64 {
        let admitted: u64 = match client {
            Some(client) => self.clients.get(client).map_or(0, |loads| loads[lane as usize].time),
            None => self.clients.values().fold(0, |sum, loads| sum.saturating_add(loads[lane as usize].time)),
        };
        let mine = |r: &&Running| r.lane == lane && client.is_none_or(|client| *client == r.client);
        let done = |r: &Running| {
            let worked = self.shared.time.saturating_sub(r.since).as_micros();
            r.time.min(worked.try_into().unwrap_or(u64::MAX))
        };
        admitted.saturating_sub(self.running.iter().filter(mine).map(done).sum())
    }

    /// How long a client's work that waits in a lane will take, and what is on its way there. O(requests that wait or come).
    fn waiting_time(&self, client: &Client, lane: Lane, now: Instant, threads: usize) -> Duration {
        let waiting: Duration =
            self.waiting[lane as usize].iter(Some(client)).map(|task| task.estimate).sum();
        waiting + self.coming.time(client, lane, self.idle(lane, threads), now)
    }

    /// The same of all clients', where what is on its way counts up to `most` of each.
    fn waiting_time_of_all(&self, most: Duration, lane: Lane, now: Instant, threads: usize) -> Duration {
        let waiting: Duration = self.waiting[lane as usize].iter(None).map(|task| task.estimate).sum();
        waiting + self.coming.time_of_all(most, lane, self.idle(lane, threads), now)
    }

    /// Threads that would take a request of this lane, beyond those that wait there.
    fn idle(&self, lane: Lane, threads: usize) -> usize {
        let at_work = self.running.iter().filter(|r| lane == Lane::Express || r.lane == lane).count();
        let all = if lane == Lane::Express { 2 * threads } else { threads };
        all.saturating_sub(at_work + self.waiting[lane as usize].iter(None).count())
    }

    fn number(&mut self) -> u64 {
        self.next_number += 1;
        self.next_number
    }

    fn backlog(&self) -> u64 {
        self.left(None, Lane::Express).saturating_add(self.left(None, Lane::Bulk))
    }

    /// When a request that comes now would be done, if the queue is fair: after its own client's work, and as much of each
    /// other client's in its lane, while the other lane has half the machine.
    fn done_in(&self, client: &Client, cost: Cost) -> Duration {
        let lane = cost.lane();
        let own = self.left(Some(client), lane).saturating_add(self.time(cost));
        let others = self.clients.keys().filter(|other| *other != client);
        let others = others.map(|other| self.left(Some(other), lane).min(own));
        let in_lane = others.fold(own, u64::saturating_add);
        let beside = match lane {
            Lane::Express => self.left(None, Lane::Bulk),
            Lane::Bulk => self.left(None, Lane::Express),
        };
        Duration::from_micros(in_lane.saturating_add(beside.min(in_lane)))
    }

    fn memory(&self) -> u64 {
        self.running.iter().map(|r| r.memory).sum()
    }

    /// The next task for a thread that takes both lanes, or small ones alone.
    fn pick(&mut self, only: Option<Lane>, memory: u64) -> Option<Arc<Task>> {
        let used = self.memory();
        let [express, bulk] = &mut self.waiting;
        let alone = self.running.is_empty();
        let fits = |task: &Arc<Task>| alone || used.saturating_add(task.memory) <= memory;
        if let Some(room) = bulk.peek().map(fits) {
            // Large ones first: small ones have threads of their own.
            if room && only.is_none() {
                return bulk.pop();
            }
            // A large one that waits for memory which small ones have gets it before further small ones; these
            // take moments.
            if !room && !self.running.iter().any(|r| r.lane == Lane::Bulk) {
                return None;
            }
        }
        express.peek().is_some_and(fits).then(|| express.pop())?
    }
}

const SECOND: Duration = Duration::from_secs(1);

/// The part of `time` after which `need` of `all` points are done; at least a second.
fn part(time: u64, need: u64, all: u64) -> Duration {
    let share = need.min(all) as f64 / all.max(1) as f64;
    Duration::from_micros((time as f64 * share) as u64).max(SECOND)
}

impl Queue {
    pub(super) fn new(bounds: Bounds, demand: Demand, clock: Arc<dyn Clock>) -> Self {
        let state = State {
            waiting: Default::default(),
            coming: Coming::new(bounds.time.unwrap_or_default()),
            points: 0,
            clients: HashMap::new(),
            running: Vec::new(),
            next_number: 0,
            shared: SharedTime::default(),
            pace: Pace::default(),
            closed: false,
        };
        Self { bounds, demand, clock, state: Mutex::new(state), changed: Condvar::new() }
    }

    /// Nothing panics while it is held, so a poisoned lock is still sound.
    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Takes the points of one request from the budget.
    pub(super) fn admit(self: &Arc<Self>, caller: &Caller, cost: Cost) -> Result<Permit, Refusal> {
        let mut state = self.lock();
        self.check(&mut state, caller, cost)?;
        let time = state.time(cost);
        state.take(&caller.client, cost, time);
        let (number, client) = (state.number(), caller.client.clone());
        let permit = Permit { queue: Arc::clone(self), client: client.clone(), cost, time, number };
        let (lane, time, since) = (cost.lane(), permit.estimate(), Some(self.clock.now()));
        state.coming.add(Expected { number, client, lane, time, since });
        Ok(permit)
    }

    /// Would a request be admitted if it were this small, or, where small ones wait for too long already, the smallest of
    /// the large?
    pub(super) fn would_admit(&self, caller: &Caller, cost: Cost) -> Result<(), Refusal> {
        let mut state = self.lock();
        let Err(refusal) = self.check(&mut state, caller, cost) else { return Ok(()) };
        let waits = matches!(refusal, Refusal::Busy { .. } | Refusal::Late { .. });
        let large = Cost { points_out: cost.points_out.max(Lane::EXPRESS + 1), ..cost };
        if waits && self.check(&mut state, caller, large).is_ok() {
            return Ok(());
        }
        // Its size is not known yet. It will hardly be the smallest there is, for which room comes soonest.
        let requests: u64 = state.clients.values().flatten().map(|load| load.requests).sum();
        let typical = Cost { points_out: cost.points_out.max(state.points / requests.max(1)), ..cost };
        let later = self.check(&mut state, caller, typical).err().and_then(|refusal| refusal.retry_after());
        Err(refusal.no_sooner(later))
    }

    /// Bytes that a request takes at its height.
    pub(super) fn memory_of(&self, cost: Cost) -> u64 {
        cost.memory(self.demand)
    }

    /// How long it will take, alone on the machine.
    pub(super) fn time_of(&self, cost: Cost) -> Duration {
        Duration::from_micros(self.lock().time(cost))
    }

    /// Checks that one request alone is within the bound of memory.
    pub(super) fn check_memory(&self, cost: Cost) -> Result<(), Refusal> {
        let (bytes, limit) = (self.memory_of(cost), self.bounds.memory);
        if bytes > limit { Err(Refusal::TooBig { bytes, limit }) } else { Ok(()) }
    }

    fn check(&self, state: &mut State, caller: &Caller, cost: Cost) -> Result<(), Refusal> {
        self.check_memory(cost)?;
        let now = self.clock.now();
        state.look(now);
        let wanted = cost.points_out;
        let (queued, used) = (state.points, state.points_of(&caller.client));
        let Bounds { points, client_points, .. } = self.bounds;
        // A request above a whole limit would never fit; it may run when it is alone.
        let above = |used: u64, limit: u64| {
            let sum = used.saturating_add(wanted);
            (used > 0 && sum > limit).then(|| sum - limit)
        };
        let full = above(queued, points).map(|need| part(state.backlog(), need, queued));
        // A share that is the whole is none.
        if let Some(need) = above(used, client_points).filter(|_| client_points < points) {
            let own = [Lane::Express, Lane::Bulk].map(|lane| state.left(Some(&caller.client), lane));
            // Its work gets its share of the machine, and the whole when the others' is done.
            let own = own[0].saturating_add(own[1]).saturating_mul(state.clients.len() as u64);
            let retry_after = part(own.min(state.backlog()), need, used).max(full.unwrap_or_default());
            return Err(Refusal::Share { wanted, used, limit: client_points, retry_after });
        }
        if let Some(retry_after) = full {
            return Err(Refusal::Full { wanted, queued, limit: points, retry_after });
        }
        self.check_time(state, &caller.client, cost.lane(), now)?;
        let left = caller.deadline.map(|deadline| deadline.saturating_duration_since(now));
        // One that is alone is always tried: estimates may be wrong, and only work corrects them.
        if let Some(left) = left.filter(|_| queued > 0) {
            let needed = state.done_in(&caller.client, cost);
            if needed > left {
                return Err(Refusal::Late { needed, left, retry_after: (needed - left).max(SECOND) });
            }
        }
        Ok(())
    }

    /// Checks that the work waiting in a lane takes no longer than it may.
    fn check_time(&self, state: &State, client: &Client, lane: Lane, now: Instant) -> Result<(), Refusal> {
        let Bounds { points, client_points, time, threads, .. } = self.bounds;
        let Some(time) = time else { return Ok(()) };
        let share = time.mul_f64(client_points as f64 / points.max(1) as f64);
        let shared = client_points < points;
        let most = if shared { share } else { Duration::MAX };
        let all = state.waiting_time_of_all(most, lane, now, threads);
        let busy = |own, waiting: Duration, limit, pace: u32| Refusal::Busy {
            own,
            waiting,
            limit,
            retry_after: (waiting - limit).saturating_mul(pace).min(all.max(waiting)).max(SECOND),
        };
        let own = state.waiting_time(client, lane, now, threads);
        if shared && own > share {
            // Its work goes at its part of the machine's pace.
            return Err(busy(true, own, share, state.clients.len().try_into().unwrap_or(u32::MAX)));
        }
        if all > time { Err(busy(false, all, time, 1)) } else { Ok(()) }
    }

    /// A task that has come, by the number of its permit.
    pub(super) fn push(&self, task: Arc<Task>, number: u64) {
        let (client, points) = (task.client.clone(), task.cost.points_out);
        let mut state = self.lock();
        state.coming.remove(number);
        state.waiting[task.cost.lane() as usize].push(&client, task, points);
        drop(state);
        // All: the one that would be woken may serve the other lane.
        self.changed.notify_all();
    }

    /// The next task, of one lane if it is given, once there is memory for it; none once the queue is closed.
    pub(super) fn next(&self, lane: Option<Lane>) -> Option<(Arc<Task>, Turn<'_>)> {
        let mut state = self.lock();
        let task = loop {
            if state.closed {
                return None;
            }
            match state.pick(lane, self.bounds.memory) {
                Some(task) => break task,
                None => state = self.changed.wait(state).unwrap_or_else(PoisonError::into_inner),
            }
        };
        state.look(self.clock.now());
        let number = state.number();
        let running = Running {
            number,
            client: task.client.clone(),
            lane: task.cost.lane(),
            memory: task.memory,
            time: state.time(task.cost),
            since: state.shared.time,
        };
        state.running.push(running);
        Some((task, Turn { queue: self, number }))
    }

    /// Takes a task back out, if it still waits.
    pub(super) fn remove(&self, task: &Arc<Task>) {
        let mut state = self.lock();
        let removed =
            state.waiting[task.cost.lane() as usize].remove(&task.client, |other| Arc::ptr_eq(other, task));
        // Dropping it may give back its permit, which takes the lock.
        drop(state);
        drop(removed);
        // It may have been the one that waited for memory.
        self.changed.notify_all();
    }

    /// Ends the queue's threads, and drops the tasks that wait.
    pub(super) fn close(&self) {
        let mut state = self.lock();
        state.closed = true;
        let tasks: Vec<_> = state.waiting.iter_mut().flat_map(Fair::drain).collect();
        drop(state);
        self.changed.notify_all();
        for task in tasks {
            task.cancel();
        }
    }

    pub(super) fn points(&self) -> u64 {
        self.lock().points
    }

    /// Bytes that the tasks at work take, as estimated.
    pub(super) fn memory(&self) -> u64 {
        self.lock().memory()
    }

    /// The bounds.
    pub(super) fn bounds(&self) -> Bounds {
        self.bounds
    }

    /// Sets the model of what requests take.
    pub(super) fn calibrate(&self, pace: Pace) {
        self.lock().pace = pace;
    }

    /// How long a request takes alone; nothing before the first measurement.
    pub(super) fn estimate(&self, cost: Cost) -> Option<Duration> {
        Some(self.lock().pace.estimate(cost)).filter(|estimate| !estimate.is_zero())
    }

    /// How long the work that is admitted and not done will take.
    pub(super) fn backlog(&self) -> Duration {
        let mut state = self.lock();
        state.look(self.clock.now());
        Duration::from_micros(state.backlog())
    }

    /// Tasks at work.
    #[cfg(test)]
    pub(super) fn running(&self) -> usize {
        self.lock().running.len()
    }

    /// Nothing is admitted, and nothing is remembered of it.
    #[cfg(test)]
    pub(super) fn is_clean(&self) -> bool {
        let state = self.lock();
        let State { points, clients, running, coming, .. } = &*state;
        *points == 0 && clients.is_empty() && running.is_empty() && coming.is_empty()
    }
}
