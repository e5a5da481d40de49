//! A Postgres of one test's own, which is stopped, killed and started again, and shows who it is.

use std::net::TcpListener;
use std::os::unix::fs::{MetadataExt, PermissionsExt, chown};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::Duration;

use rcgen::{BasicConstraints, CertificateParams, CertifiedIssuer, IsCa, KeyPair};
use tempfile::TempDir;

use super::records::{get, put};
use super::*;

/// A Postgres, as long as this is there.
struct Server {
    folder: TempDir,
    port: u16,
    process: Child,
}

impl Server {
    fn start() -> Self {
        let folder = tempfile::tempdir().expect("a folder");
        // It may run as somebody else.
        std::fs::set_permissions(folder.path(), PermissionsExt::from_mode(0o711)).expect("a mode");
        let free = TcpListener::bind(("127.0.0.1", 0)).expect("a port");
        let port = free.local_addr().expect("an address").port();
        drop(free);
        let process = run(&folder.path().join("data"), port, &[]);
        let server = Self { folder, port, process };
        server.wait();
        server
    }

    /// At the same port, after its end, with all that it had.
    fn start_again(&mut self, options: &[&str]) {
        loop {
            self.process = run(&self.data(), self.port, options);
            // What is left of the last one may still be there for a moment.
            while self.process.try_wait().expect("a process").is_none() {
                if self.answers() {
                    return;
                }
            }
        }
    }

    fn data(&self) -> PathBuf {
        self.folder.path().join("data")
    }

    fn wait(&self) {
        while !self.answers() {}
    }

    fn answers(&self) -> bool {
        let (address, password) = self.address("127.0.0.1", "sslmode=disable");
        Postgres::execute(&address, &password, "SELECT 1").is_ok()
    }

    fn address(&self, host: &str, options: &str) -> (Address, Password) {
        let text = format!("postgres://test@{host}:{}/postgres?{options}", self.port);
        (Address::parse(&text).expect("an address"), "test".to_owned().into())
    }

    fn open(&self, host: &str, options: &str) -> Result<Postgres, StoreError> {
        let (address, password) = self.address(host, options);
        let limits = Limits { connections: 2, deadline: Duration::from_secs(3) };
        Postgres::open(&address, Some(&password), limits, "kind", BOUNDS)
    }

    /// To it, and to the processes that it started.
    fn signal(&self, name: &str) {
        let main = self.process.id();
        let children =
            std::fs::read_to_string(format!("/proc/{main}/task/{main}/children")).unwrap_or_default();
        let all = children.split_whitespace().map(str::to_owned).chain([main.to_string()]);
        // Some may have ended meanwhile.
        let kill = Command::new("sh")
            .args(["-c", "kill -s \"$@\"", "kill", name])
            .args(all)
            .stderr(Stdio::null())
            .status();
        kill.expect("a shell");
    }

    fn kill(&mut self) {
        self.signal("KILL");
        self.process.wait().expect("it is over");
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        self.kill();
    }
}

fn run(data: &Path, port: u16, options: &[&str]) -> Child {
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../scripts/postgres.sh");
    let mut command = Command::new("sh");
    command.arg(script).arg(data).arg(port.to_string()).args(["-c", "fsync=off"]).args(options);
    command.stdout(Stdio::null()).stderr(Stdio::null()).spawn().expect("a process")
}

#[test]
#[ignore = "needs scripts/with-services.sh"]
fn a_server_that_is_stopped_or_killed_is_missed_in_time_and_found_again() {
    let mut server = Server::start();
    let records = server.open("127.0.0.1", "sslmode=disable").expect("a database");
    let id = put(&records, &of("a", None), 0);
    let late = Draft::new(of("late", None)).expect("a draft");
    let missed = |records: &Postgres| {
        for away in [records.get(&id).map(drop), records.insert("late", &late, 0).map(drop)] {
            let away = away.expect_err("nobody answers");
            assert!(away.is_away() && !away.is_unsure(), "{away:?}");
        }
    };
    server.signal("STOP");
    missed(&records);
    server.signal("CONT");
    assert_eq!(get(&records, &id).id, id);
    server.kill();
    missed(&records);
    server.start_again(&[]);
    assert_eq!(get(&records, &id).id, id);
    assert_eq!(records.get("late").expect("no fault"), None);
    assert!(records.cancel(&id, 1).expect("no fault"));
}

/// Who says who is who, and what it says of a server of this machine's, and its key.
fn certificates() -> [String; 3] {
    let mut authority = CertificateParams::default();
    authority.is_ca = IsCa::Ca(BasicConstraints::Unconstrained);
    let key = || KeyPair::generate().expect("a key");
    let authority = CertifiedIssuer::self_signed(authority, key()).expect("a certificate");
    let own = key();
    let server = CertificateParams::new(["127.0.0.1".to_owned()]).expect("a name");
    let server = server.signed_by(&own, &authority).expect("a certificate");
    [authority.pem(), server.pem(), own.serialize_pem()]
}

#[test]
#[ignore = "needs scripts/with-services.sh"]
fn a_server_must_show_who_it_is() {
    let mut server = Server::start();
    let [authority, certificate, key] = certificates();
    let [other, ..] = certificates();
    let file = |name: &str, text: &str| {
        let path = server.folder.path().join(name);
        std::fs::write(&path, text).expect("a file");
        path.display().to_string()
    };
    let [authority, other] = [file("ca.pem", &authority), file("other.pem", &other)];
    let [certificate, key] = [file("server.pem", &certificate), file("server.key", &key)];
    std::fs::set_permissions(&key, PermissionsExt::from_mode(0o600)).expect("a mode");
    let owner = std::fs::metadata(server.data()).expect("a folder");
    chown(&key, Some(owner.uid()), Some(owner.gid())).expect("its owner");
    let strict = format!("sslmode=verify-full&sslrootcert={authority}");
    let refused = |server: &Server, host: &str, options: &str, why: &str| {
        let error = server.open(host, options).map(drop).expect_err("it is nobody").to_string();
        assert!(error.contains(why), "{error}");
    };
    refused(&server, "127.0.0.1", &strict, "does not support TLS");
    server.kill();
    let files = [format!("ssl_cert_file={certificate}"), format!("ssl_key_file={key}")];
    server.start_again(&["-c", "ssl=on", "-c", &files[0], "-c", &files[1]]);
    let records = server.open("127.0.0.1", &strict).expect("a database");
    put(&records, &of("a", None), 0);
    let (address, password) = server.address("127.0.0.1", &strict);
    let hidden = "DO 'BEGIN ASSERT (SELECT ssl FROM pg_stat_ssl WHERE pid = pg_backend_pid()); END'";
    Postgres::execute(&address, &password, hidden).expect("nobody reads along");
    refused(&server, "127.0.0.1", &format!("sslmode=verify-full&sslrootcert={other}"), "certificate");
    refused(&server, "127.0.0.1", "sslmode=verify-full", "certificate");
    refused(&server, "localhost", &strict, "not valid for name");
}
