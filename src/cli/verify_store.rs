//! `kincal verify-store`: checks the promises I1 to I9 on a database.

use super::runtime::block_on;
use super::terminal::Output;
use super::usage::Usage;
use crate::config::DatabaseConfig;
use crate::http::server::location;
use crate::store::verify::{self, Check, Options};
use crate::store::{Store, audit};
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
        .map(parse_head)
        .transpose()?;
    block_on(async {
        let store = Store::open_as_it_is(location(&arguments.database)).await?;
        let options = Options {
            known_head,
            is_served: store.is_served(),
        };
        let checks = verify::verify(&store, &options).await?;
        let head = audit::head(&store).await?;
        let n_violations: i64 = checks.iter().map(|check| check.n_violations).sum();
        let mut out = std::io::stdout().lock();
        if arguments.output.json {
            writeln!(out, "{}", json(&checks, &head, n_violations))?;
        } else {
            table(&mut out, &checks)?;
            writeln!(out, "head of the audit chain: {}:{}", head.seq, head.sha256)?;
        }
        drop(out);
        store.close().await;
        anyhow::ensure!(n_violations == 0, "{n_violations} violations");
        Ok(())
    })
}

fn parse_head(text: &str) -> Result<(i64, String), Usage> {
    let parsed = text
        .split_once(':')
        .and_then(|(seq, hash)| Some((seq.parse().ok()?, hash.to_owned())));
    let is_hash = |hash: &str| {
        hash.len() == 64
            && hash
                .bytes()
                .all(|byte| matches!(byte, b'0'..=b'9' | b'a'..=b'f'))
    };
    let parsed = parsed
        .filter(|(seq, hash): &(i64, String)| is_hash(hash) || (*seq == 0 && hash.is_empty()));
    parsed.ok_or_else(|| {
        Usage(
            "--known-head is a number, a colon and a hash, as `kincal verify-store` prints it"
                .into(),
        )
    })
}

fn json(checks: &[Check], head: &crate::store::AuditHead, n_violations: i64) -> serde_json::Value {
    let one = |check: &Check| {
        serde_json::json!({"id": check.id, "promise": check.promise, "n_examined": check.n_examined,
            "n_violations": check.n_violations, "violations": check.violations})
    };
    serde_json::json!({"ok": n_violations == 0, "n_violations": n_violations, "checks": checks.iter().map(one).collect::<Vec<_>>(),
        "audit_head": format!("{}:{}", head.seq, head.sha256)})
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
            "{}  {verdict:10}  {:>8} looked at  {}",
            check.id, check.n_examined, check.promise
        )?;
        for violation in &check.violations {
            writeln!(out, "      {violation}")?;
        }
    }
    Ok(())
}
