//! What many workers ask of the jobs' database, and how busy it leaves them: workers whose tiles take their time asleep,
//! over a real Postgres.
//!
//! ```text
//! sh scripts/with-services.sh cargo bench -p densecloud-jobs --bench fleet -- [MACHINES [THREADS [TILES [MILLISECONDS]]]]
//! ```
//!
//! The machines are in one process, each with connections and a clock of its own; clouds and parts, of some bytes, lie in a
//! folder. One job has all the tiles. Tiles take half to one and a half times so long.

use std::io::{self, Write};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use densecloud_jobs::{
    Admitted, Begun, BlobReader, Draft, How, Jobs, Keeping, NewJob, Parts, Place, Record, Settings, State,
    Step, Stopped, Submitted, Task, Work,
};

/// Work that sleeps.
struct Sleeper {
    tiles: usize,
    each: Duration,
    /// When each began and ended.
    spans: Mutex<Vec<[Instant; 2]>>,
}

impl Sleeper {
    /// Seconds from when the first tile began until the last one did, and what all workers slept in between: after that
    /// there is nothing left for those that are free.
    fn sums(&self) -> [f64; 2] {
        let spans = self.spans.lock().expect("no panic under it");
        let begun = || spans.iter().map(|[start, _]| *start);
        let (first, last) = (begun().min().expect("tiles"), begun().max().expect("tiles"));
        let slept = spans.iter().map(|[start, end]| (*end.min(&last) - *start).as_secs_f64()).sum();
        [(last - first).as_secs_f64(), slept]
    }
}

fn leave(place: &Place) -> io::Result<()> {
    let mut blob = place.blobs.create(&place.own)?;
    blob.write_all(b"some bytes")?;
    blob.finish()
}

impl Work for Sleeper {
    fn begin(
        &self,
        _job: &Record,
        _input: Box<dyn BlobReader>,
        place: &Place,
        _task: &Task,
        _sink: &mut dyn Write,
    ) -> Result<Begun, Stopped> {
        leave(place)?;
        Ok(Begun::Split { sizes: vec![1; self.tiles], bytes: 1000 })
    }

    fn tile(&self, _job: &Record, tile: u32, place: &Place, _task: &Task) -> Result<u64, Stopped> {
        let start = Instant::now();
        // Spread evenly, the same each time.
        let share = 0.5 + f64::from(tile.wrapping_mul(0x9e37_79b9)) / f64::from(u32::MAX);
        std::thread::sleep(self.each.mul_f64(share));
        self.spans.lock().expect("no panic under it").push([start, Instant::now()]);
        leave(place)?;
        Ok(1)
    }

    fn join(
        &self,
        _job: &Record,
        parts: Parts,
        _place: &Place,
        _task: &Task,
        sink: &mut dyn Write,
    ) -> Result<String, Stopped> {
        write!(sink, "{}", parts.names.len())?;
        Ok(String::new())
    }

    fn ended(&self, step: Step, how: How, _took: Duration) {
        assert_eq!(how, How::Done, "{step:?}");
    }
}

/// Of the database's transactions, and the processor's seconds of its processes where they run here.
fn load(address: &str) -> (i64, f64) {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().expect("a runtime");
    let (address, _) = address.split_once('?').expect("options");
    runtime.block_on(async {
        let mut config: tokio_postgres::Config = address.parse().expect("an address");
        config.password(std::env::var("PGPASSWORD").unwrap_or_default());
        let (client, connection) = config.connect(tokio_postgres::NoTls).await.expect("a database");
        tokio::spawn(connection);
        let sql =
            "SELECT xact_commit + xact_rollback FROM pg_stat_database WHERE datname = current_database()";
        let count = client.query_one(sql, &[]).await.expect("a count").get(0);
        let rows = client.query("SELECT pid FROM pg_stat_activity", &[]).await.expect("processes");
        (count, rows.iter().filter_map(|row| seconds(row.get(0))).sum())
    })
}

/// Seconds of the processor that a process of this machine took, where there are a hundred ticks in one.
fn seconds(process: i32) -> Option<f64> {
    let stat = std::fs::read_to_string(format!("/proc/{process}/stat")).ok()?;
    let fields: Vec<&str> = stat.rsplit_once(')')?.1.split_whitespace().collect();
    Some((fields[11].parse::<f64>().ok()? + fields[12].parse::<f64>().ok()?) / 100.0)
}

fn main() {
    let numbers: Vec<usize> = std::env::args().skip(1).filter_map(|argument| argument.parse().ok()).collect();
    let number = |place: usize, default| numbers.get(place).copied().unwrap_or(default);
    let (machines, threads, tiles) = (number(0, 20), number(1, 10), number(2, 2000));
    let each = Duration::from_millis(number(3, 2000) as u64);
    let folder = tempfile::tempdir().expect("a folder");
    let database = std::env::var("DENSECLOUD_TEST_POSTGRES").expect("see scripts/with-services.sh");
    let settings = |machine: usize| Settings {
        keeping: Keeping::Shared {
            database: format!("{database}&schema=fleet{}", std::process::id()),
            password: None,
            store: folder.path().display().to_string(),
            process: format!("machine {machine}"),
            kind: "sleeper".to_owned(),
        },
        running: threads,
        lease: Duration::from_secs(30),
        ..Settings::new(folder.path().to_owned())
    };
    let sleeper = Arc::new(Sleeper { tiles, each, spans: Mutex::default() });
    let fleet: Vec<Arc<Jobs>> =
        (0..machines).map(|machine| Arc::new(Jobs::open(settings(machine)).expect("a store"))).collect();
    let work: Arc<dyn Work> = Arc::clone(&sleeper) as Arc<dyn Work>;
    fleet.iter().for_each(|jobs| jobs.start(&work).expect("threads"));
    let before = load(&database);
    let id = submit(&fleet[0]);
    while fleet[0].store().get(&id).expect("no fault").expect("the job").state != State::Done {
        std::thread::sleep(Duration::from_millis(200));
    }
    let after = load(&database);
    let [wall, slept] = sleeper.sums();
    println!(
        "{} workers, {tiles} tiles of {each:?}: {wall:.1} s, {:.1} % busy; {:.0} tiles, {:.0} transactions, \
         {:.2} s of the database's processor a second; {:.1} transactions a tile",
        machines * threads,
        100.0 * slept / wall / (machines * threads) as f64,
        tiles as f64 / wall,
        (after.0 - before.0) as f64 / wall,
        (after.1 - before.1) / wall,
        (after.0 - before.0) as f64 / tiles as f64,
    );
    fleet.iter().for_each(|jobs| jobs.stop());
    fleet.iter().for_each(|jobs| jobs.join());
}

fn submit(jobs: &Jobs) -> String {
    let new = NewJob {
        request: String::new(),
        key: None,
        owner: String::new(),
        client: String::new(),
        request_id: String::new(),
        points_in: 1,
        points_out: 1,
        result_bytes: 1,
        input: Arc::new(b"a cloud".to_vec()),
    };
    let draft = Draft::new(new).expect("a draft");
    let Admitted::New(id) = jobs.store().admit(&draft).expect("room") else { panic!("it is new") };
    let input = jobs.store().write_input(&id, &draft).expect("room");
    assert!(matches!(jobs.insert(&draft, input), Ok(Submitted::New(_))));
    id
}
