//! A private PostgreSQL server, which a test may stop, and kincal's nodes on it as real processes.

use crate::process::{Server, kincal};
use std::net::TcpListener;
use std::path::PathBuf;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};
use tempfile::TempDir;

/// Longest start of PostgreSQL; it usually takes under a second.
const START_WITHIN: Duration = Duration::from_secs(30);

/// A running PostgreSQL on a free loopback port.
pub struct Cluster {
    home: TempDir,
    bin: PathBuf,
    port: u16,
}

impl Cluster {
    /// A new cluster; `None` with a clear message if PostgreSQL is not installed.
    pub fn start() -> Option<Self> {
        if std::env::var("TEST_POSTGRES_URL").is_err() {
            say("!!! TEST_POSTGRES_URL IS NOT SET: THE TESTS WITH SEVERAL NODES DO NOT RUN !!!");
            return None;
        }
        let Some(bin) = newest_bin() else {
            say(
                "!!! NO initdb UNDER /usr/lib/postgresql: THE TESTS WITH SEVERAL NODES DO NOT RUN !!!",
            );
            return None;
        };
        let home = tempfile::tempdir().unwrap();
        let port = TcpListener::bind("127.0.0.1:0")
            .unwrap()
            .local_addr()
            .unwrap()
            .port();
        let cluster = Self { home, bin, port };
        if is_root() {
            assert!(
                Command::new("chown")
                    .arg("postgres")
                    .arg(cluster.home.path())
                    .status()
                    .unwrap()
                    .success()
            );
        }
        cluster.run(
            "initdb",
            &[
                "--auth=trust",
                "--username=postgres",
                "--no-sync",
                "--encoding=UTF8",
                "-D",
                &cluster.data(),
            ],
        );
        cluster.up();
        Some(cluster)
    }

    /// Its URL for kincal.
    pub fn url(&self) -> String {
        format!("postgres://postgres@127.0.0.1:{}/postgres", self.port)
    }

    /// Starts PostgreSQL and waits until it answers.
    pub fn up(&self) {
        let options = format!(
            "-c listen_addresses=127.0.0.1 -c port={} -c unix_socket_directories= -c max_connections=100 -c log_min_messages=fatal",
            self.port
        );
        let log = self.home.path().join("log").display().to_string();
        self.run(
            "pg_ctl",
            &[
                "start",
                "--wait",
                "--silent",
                "-D",
                &self.data(),
                "-l",
                &log,
                "-o",
                &options,
            ],
        );
    }

    /// Stops it as a power failure does: connections get no notice, and no checkpoint is written.
    pub fn crash(&self) {
        self.run(
            "pg_ctl",
            &["stop", "--mode=immediate", "--silent", "-D", &self.data()],
        );
    }

    /// Cuts all connections of the nodes, even during a statement.
    pub fn cut_connections(&self) {
        let sql = "select pg_terminate_backend(pid) from pg_stat_activity where pid <> pg_backend_pid() and backend_type = 'client backend'";
        let psql = self.bin.join("psql");
        let _ = Command::new(psql)
            .args([&self.url(), "-qc", sql])
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .status();
    }

    /// The result of a query, as text.
    pub fn query(&self, sql: &str) -> String {
        let psql = self.bin.join("psql");
        let output = Command::new(psql)
            .args([&self.url(), "-qAtc", sql])
            .output()
            .unwrap();
        assert!(
            output.status.success(),
            "{}",
            String::from_utf8_lossy(&output.stderr)
        );
        String::from_utf8(output.stdout).unwrap().trim().to_owned()
    }

    /// An API node.
    pub fn api_node(&self, more: &[&str]) -> Server {
        let mut command = kincal(&[
            "serve",
            "--listen",
            "127.0.0.1:0",
            "--workers",
            "0",
            "--database-url",
            &self.url(),
        ]);
        command.args(more).env("KINCAL_LEASE_S", "2");
        Server::of(command)
    }

    /// A compute node with one worker.
    pub fn worker(&self) -> Worker {
        self.node_of_workers(1)
    }

    /// A compute node with several workers.
    pub fn node_of_workers(&self, n: usize) -> Worker {
        let (n, url) = (n.to_string(), self.url());
        let mut command = kincal(&["worker", "--workers", &n, "--database-url", &url]);
        Worker(
            command
                .env("KINCAL_LEASE_S", "2")
                .stdout(Stdio::null())
                .stderr(Stdio::null())
                .spawn()
                .unwrap(),
        )
    }

    /// Checks I1 to I9 at the end.
    pub fn verify(&self) {
        let checked = crate::process::run(&["verify-store", "--database-url", &self.url()]);
        assert!(
            checked.status.success(),
            "{}{}",
            String::from_utf8_lossy(&checked.stdout),
            String::from_utf8_lossy(&checked.stderr)
        );
    }

    fn data(&self) -> String {
        self.home.path().join("data").display().to_string()
    }

    fn run(&self, program: &str, arguments: &[&str]) {
        let program = self.bin.join(program);
        // PostgreSQL refuses to run as root.
        let mut command = if is_root() {
            let mut command = Command::new("runuser");
            command.args(["-u", "postgres", "--"]).arg(&program);
            command
        } else {
            Command::new(&program)
        };
        let since = Instant::now();
        let status = command
            .args(arguments)
            .current_dir(self.home.path())
            .stdout(Stdio::null())
            .status()
            .unwrap();
        assert!(
            status.success() && since.elapsed() < START_WITHIN,
            "{} {arguments:?}: {status}",
            program.display()
        );
    }
}

impl Drop for Cluster {
    fn drop(&mut self) {
        // Also when the test panics; an error of a server that is already down is ignored.
        let stop = || {
            self.run(
                "pg_ctl",
                &["stop", "--mode=immediate", "--silent", "-D", &self.data()],
            )
        };
        let _ = std::panic::catch_unwind(std::panic::AssertUnwindSafe(stop));
    }
}

/// A running `kincal worker`.
pub struct Worker(Child);

impl Worker {
    /// kill -9, and waits until it is gone.
    pub fn kill(mut self) {
        self.0.kill().unwrap();
        self.0.wait().unwrap();
    }

    /// Sends a signal: KILL, STOP, CONT, TERM.
    pub fn signal(&self, name: &str) {
        assert!(
            Command::new("kill")
                .args([&format!("-{name}"), &self.0.id().to_string()])
                .status()
                .unwrap()
                .success()
        );
    }
}

impl Drop for Worker {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

fn newest_bin() -> Option<PathBuf> {
    let versions = std::fs::read_dir("/usr/lib/postgresql").ok()?;
    let bins = versions.filter_map(|version| Some(version.ok()?.path().join("bin")));
    bins.filter(|bin| bin.join("initdb").is_file()).max()
}

fn is_root() -> bool {
    effective_user() == Some(0)
}

/// The effective user, without another dependency.
fn effective_user() -> Option<u32> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    status
        .lines()
        .find_map(|line| line.strip_prefix("Uid:"))?
        .split_whitespace()
        .nth(1)?
        .parse()
        .ok()
}

fn say(line: &str) {
    use std::io::Write;
    let _ = writeln!(std::io::stderr(), "{line}");
}
