//! Settings from flags and environment variables, in flat structs that are checked once.

use clap::builder::RangedU64ValueParser;
use clap::value_parser;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Longest time for requests and running jobs to end when a process stops. It is below the 10 s after which service managers kill a process.
pub const STOP_WITHIN: Duration = Duration::from_secs(8);

/// Where the database is.
#[derive(Clone, Debug, PartialEq, Eq, clap::Args)]
pub struct DatabaseConfig {
    /// Directory of the embedded database; made if it is missing.
    #[arg(
        long,
        env = "KINCAL_DATA_DIR",
        default_value = "./kincal-data",
        value_name = "DIR"
    )]
    pub data_dir: PathBuf,
    /// PostgreSQL instead of the embedded database: postgres://user:password@host/database.
    #[arg(
        long,
        env = "KINCAL_DATABASE_URL",
        value_name = "URL",
        hide_env_values = true
    )]
    pub database_url: Option<String>,
}

/// Limits on clients. The defaults suit a factory.
#[derive(Clone, Debug, PartialEq, Eq, clap::Args)]
pub struct LimitsConfig {
    /// Clients connected at the same time; one more is answered 503.
    #[arg(
        long,
        env = "KINCAL_MAX_CONNECTIONS",
        default_value_t = LimitsConfig::default().max_connections,
        value_parser = RangedU64ValueParser::<usize>::new().range(1..=100_000),
        value_name = "N"
    )]
    pub max_connections: usize,
    /// How long a client may be silent, seconds: before its request, within it, between requests, and when it should read.
    #[arg(
        long,
        env = "KINCAL_CLIENT_TIMEOUT_S",
        default_value_t = LimitsConfig::default().client_timeout_s,
        value_parser = value_parser!(u64).range(1..=600),
        value_name = "SECONDS"
    )]
    pub client_timeout_s: u64,
    /// Requests a second of one key, twice as many in a burst; 0 for no limit. More are answered 429.
    #[arg(
        long,
        env = "KINCAL_RATE_PER_KEY",
        default_value_t = LimitsConfig::default().rate_per_key,
        value_name = "N"
    )]
    pub rate_per_key: u32,
}

impl Default for LimitsConfig {
    fn default() -> Self {
        Self {
            max_connections: 4096,
            client_timeout_s: 10,
            rate_per_key: 500,
        }
    }
}

impl LimitsConfig {
    /// How long a client may be silent.
    pub fn client_timeout(&self) -> Duration {
        Duration::from_secs(self.client_timeout_s)
    }
}

/// Certificate and key for TLS.
#[derive(Clone, Debug, Default, PartialEq, Eq, clap::Args)]
pub struct TlsConfig {
    /// Certificate chain for TLS, PEM.
    #[arg(
        long,
        env = "KINCAL_TLS_CERT",
        requires = "tls_key",
        value_name = "FILE"
    )]
    pub tls_cert: Option<PathBuf>,
    /// Private key for TLS, PEM.
    #[arg(
        long,
        env = "KINCAL_TLS_KEY",
        requires = "tls_cert",
        value_name = "FILE"
    )]
    pub tls_key: Option<PathBuf>,
    /// Speak plain HTTP beyond this machine: keys and measurements can be read on the way.
    #[arg(long, env = "KINCAL_INSECURE_HTTP", value_parser = clap::builder::FalseyValueParser::new(), action = clap::ArgAction::SetTrue)]
    pub insecure_http: bool,
}

impl TlsConfig {
    /// Certificate and key, if both are given.
    pub fn files(&self) -> Option<(&Path, &Path)> {
        self.tls_cert.as_deref().zip(self.tls_key.as_deref())
    }
}

/// Leases and attempts of jobs.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::Args)]
pub struct QueueConfig {
    /// How long a worker that stopped answering keeps its job, seconds.
    #[arg(
        long,
        env = "KINCAL_LEASE_S",
        default_value_t = QueueConfig::default().lease_s,
        value_parser = value_parser!(u64).range(1..=3600),
        value_name = "SECONDS"
    )]
    pub lease_s: u64,
    /// Attempts at a job before it fails.
    #[arg(
        long,
        env = "KINCAL_MAX_ATTEMPTS",
        default_value_t = QueueConfig::default().max_attempts,
        value_parser = value_parser!(u32).range(1..=100),
        value_name = "N"
    )]
    pub max_attempts: u32,
    /// How long one attempt may compute, seconds; the largest jobs that are accepted take minutes.
    #[arg(
        long,
        env = "KINCAL_MAX_JOB_S",
        default_value_t = QueueConfig::default().max_job_s,
        value_parser = value_parser!(u64).range(1..=604_800),
        value_name = "SECONDS"
    )]
    pub max_job_s: u64,
}

impl QueueConfig {
    /// The lease of a job.
    pub fn lease(&self) -> Duration {
        Duration::from_secs(self.lease_s)
    }
}

impl Default for QueueConfig {
    fn default() -> Self {
        Self {
            lease_s: 15,
            max_attempts: 3,
            max_job_s: 21_600,
        }
    }
}

/// Settings of `kincal worker`.
#[derive(Clone, Debug, PartialEq, Eq, clap::Args)]
pub struct WorkerConfig {
    /// Where the database is: PostgreSQL, which several processes can share.
    #[command(flatten)]
    pub database: DatabaseConfig,
    /// Calibrations that run at the same time; default: one per core.
    #[arg(long, env = "KINCAL_WORKERS", value_name = "N", value_parser = RangedU64ValueParser::<usize>::new().range(1..=256))]
    pub workers: Option<usize>,
    /// Leases and attempts.
    #[command(flatten)]
    pub queue: QueueConfig,
}

impl WorkerConfig {
    /// Checks the settings.
    pub fn check(&self) -> Result<(), Error> {
        if self.database.database_url.is_none() {
            return Err(Error::NoSharedDatabase);
        }
        Ok(())
    }
}

/// Number of workers to start.
pub fn n_workers(asked: Option<usize>) -> usize {
    asked.unwrap_or_else(|| std::thread::available_parallelism().map_or(1, usize::from))
}

/// Settings of `kincal serve`.
#[derive(Clone, Debug, PartialEq, Eq, clap::Args)]
pub struct ServeConfig {
    /// Address and port; port 0 takes a free one.
    #[arg(
        long,
        env = "KINCAL_LISTEN",
        default_value = "127.0.0.1:8080",
        value_name = "ADDRESS:PORT"
    )]
    pub listen: SocketAddr,
    /// Where the database is.
    #[command(flatten)]
    pub database: DatabaseConfig,
    /// Calibrations that run at the same time; default: one per core; 0 only serves.
    #[arg(long, env = "KINCAL_WORKERS", value_name = "N", value_parser = RangedU64ValueParser::<usize>::new().range(..=256))]
    pub workers: Option<usize>,
    /// Let everyone in without a key; loopback addresses only.
    #[arg(long, env = "KINCAL_NO_AUTH", value_parser = clap::builder::FalseyValueParser::new(), action = clap::ArgAction::SetTrue)]
    pub no_auth: bool,
    /// Leases and attempts.
    #[command(flatten)]
    pub queue: QueueConfig,
    /// Limits on clients.
    #[command(flatten)]
    pub limits: LimitsConfig,
    /// Certificate and key.
    #[command(flatten)]
    pub tls: TlsConfig,
}

/// Settings that cannot be used together; exit code 2.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Error {
    /// `--no-auth` beyond loopback addresses: anyone on the network could move a robot.
    #[error(
        "--no-auth lets everyone in, so it is accepted on loopback addresses only, not on {listen}: listen on 127.0.0.1, or make a key with `kincal key create`"
    )]
    NoAuthBeyondLoopback {
        /// The requested address.
        listen: SocketAddr,
    },
    /// Plain HTTP beyond loopback addresses: keys would cross the network in clear text.
    #[error(
        "{listen} is beyond this machine, and plain HTTP shows keys to everyone on the way: give --tls-cert and --tls-key, listen on 127.0.0.1 behind a proxy that speaks TLS, or say --insecure-http"
    )]
    PlainHttpBeyondLoopback {
        /// The requested address.
        listen: SocketAddr,
    },
    /// `kincal worker` without PostgreSQL: it needs a database that API nodes can reach.
    #[error(
        "a worker takes its jobs from a PostgreSQL that API nodes share: give --database-url postgres://…; with the embedded database `kincal serve` computes itself"
    )]
    NoSharedDatabase,
}

impl ServeConfig {
    /// Settings of a server without keys on a free loopback port, for `demo` and the tests.
    pub fn loopback(data_dir: PathBuf, workers: usize) -> Self {
        Self {
            listen: SocketAddr::from(([127, 0, 0, 1], 0)),
            database: DatabaseConfig {
                data_dir,
                database_url: None,
            },
            workers: Some(workers),
            no_auth: true,
            queue: QueueConfig::default(),
            limits: LimitsConfig::default(),
            tls: TlsConfig::default(),
        }
    }

    /// Checks the settings.
    pub fn check(&self) -> Result<(), Error> {
        if self.no_auth && !self.listen.ip().is_loopback() {
            return Err(Error::NoAuthBeyondLoopback {
                listen: self.listen,
            });
        }
        if !self.listen.ip().is_loopback() && self.tls.files().is_none() && !self.tls.insecure_http
        {
            return Err(Error::PlainHttpBeyondLoopback {
                listen: self.listen,
            });
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::{Error, ServeConfig, TlsConfig};
    use clap::Parser;

    #[test]
    fn everyone_is_let_in_on_loopback_addresses_only() {
        let mut config = ServeConfig::loopback("data".into(), 1);
        assert_eq!(config.check(), Ok(()));
        config.listen = "[::1]:0".parse().unwrap();
        assert_eq!(config.check(), Ok(()));
        for listen in ["0.0.0.0:8080", "192.168.1.5:8080", "[::]:8080"] {
            config.listen = listen.parse().unwrap();
            assert_eq!(
                config.check(),
                Err(Error::NoAuthBeyondLoopback {
                    listen: config.listen
                })
            );
        }
        config.no_auth = false;
        assert_eq!(
            config.check(),
            Err(Error::PlainHttpBeyondLoopback {
                listen: config.listen
            })
        );
    }

    #[test]
    fn beyond_loopback_it_is_tls_or_said_aloud() {
        let mut config = ServeConfig {
            no_auth: false,
            listen: "0.0.0.0:8080".parse().unwrap(),
            ..ServeConfig::loopback("data".into(), 1)
        };
        assert!(config.check().is_err());
        config.tls.insecure_http = true;
        assert_eq!(config.check(), Ok(()));
        config.tls = TlsConfig {
            tls_cert: Some("c.pem".into()),
            tls_key: Some("k.pem".into()),
            insecure_http: false,
        };
        assert_eq!(config.check(), Ok(()));
        config.no_auth = true;
        assert_eq!(
            config.check(),
            Err(Error::NoAuthBeyondLoopback {
                listen: config.listen
            })
        );
    }

    #[test]
    fn numbers_beyond_their_range_are_refused() {
        #[derive(clap::Parser)]
        struct Serve {
            #[command(flatten)]
            _config: ServeConfig,
        }
        for (option, wrong, right) in [
            ("--lease-s", "0", "3600"),
            ("--max-attempts", "101", "100"),
            ("--max-job-s", "604801", "1"),
            ("--client-timeout-s", "601", "600"),
            ("--max-connections", "0", "100000"),
            ("--workers", "257", "0"),
        ] {
            let parsed = |value| Serve::try_parse_from(["serve", option, value]);
            assert!(parsed(right).is_ok(), "{option} {right}");
            let error = parsed(wrong).err().expect(option);
            assert_eq!(error.exit_code(), 2);
            assert!(error.to_string().contains(option), "{error}");
        }
    }
}
