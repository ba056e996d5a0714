//! `kincal verify-store`: checks the promises I1 to I9 on a database.

use super::runtime::block_on;
use super::terminal::Output;
use super::usage::Usage;
use crate::config::DatabaseConfig;
use crate::store::verify::{self, Check, Options};
use crate::store::{AuditEntryId, NoAuditEntryId, Store, StoreLocation, audit};
use std::io::Write;

/// Check the database; may run while a server uses it. Exit code 1 if a promise is broken.
#[derive(Debug, clap::Args)]
pub struct Arguments {
    #[command(flatten)]
    database: DatabaseConfig,
    /// A head of the audit chain from an earlier run, which must still be in the chain: NUMBER:HASH.
    #[arg(long, env = "KINCAL_KNOWN_HEAD", value_name = "NUMBER:HASH")]
    known_head: Option<String>,
    #[command(flatten)]
    output: Output,
}

/// Runs the checks and prints their results.
pub fn run(arguments: &Arguments) -> anyhow::Result<()> {
    let known_head = arguments
        .known_head
        .as_deref()
        .map(str::parse)
        .transpose()
        .map_err(|_: NoAuditEntryId| {
            Usage(
                "--known-head is a number, a colon and a hash, as `kincal verify-store` prints it"
                    .into(),
            )
        })?;
    block_on(async {
        let store = Store::open_unmigrated(StoreLocation::from(&arguments.database)).await?;
        let options = Options {
            known_head,
            is_served: store.is_served(),
        };
        let checks = verify::verify(&store, &options).await?;
        let head = audit::head(&store).await?.entry();
        let n_violations: i64 = checks.iter().map(|check| check.n_violations).sum();
        let mut out = std::io::stdout().lock();
        if arguments.output.json {
            writeln!(out, "{}", json(&checks, &head, n_violations))?;
        } else {
            table(&mut out, &checks)?;
            writeln!(out, "head of the audit chain: {head}")?;
        }
        drop(out);
        store.close().await;
        anyhow::ensure!(n_violations == 0, "{n_violations} violations");
        Ok(())
    })
}

fn json(checks: &[Check], head: &AuditEntryId, n_violations: i64) -> serde_json::Value {
    let one = |check: &Check| {
        serde_json::json!({"id": check.id, "promise": check.promise, "n_examined": check.n_examined,
            "n_violations": check.n_violations, "violations": check.violations})
    };
    serde_json::json!({"ok": n_violations == 0, "n_violations": n_violations, "checks": checks.iter().map(one).collect::<Vec<_>>(),
        "audit_head": head.to_string()})
}

fn table(out: &mut impl Write, checks: &[Check]) -> std::io::Result<()> {
    for check in checks {
        let verdict = if check.n_violations == 0 {
            "kept".to_owned()
        } else {
            format!("BROKEN {}×", check.n_violations)
        };
        writeln!(
            out,
            "{}  {verdict:10}  {:>8} examined   {}",
            check.id, check.n_examined, check.promise
        )?;
        for violation in &check.violations {
            writeln!(out, "      {violation}")?;
        }
    }
    Ok(())
}
