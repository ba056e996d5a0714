//! `kincal openapi`.

use std::io::Write;

/// Prints the document.
pub fn run() -> anyhow::Result<()> {
    let text = crate::http::yaml().map_err(anyhow::Error::msg)?;
    Ok(std::io::stdout().lock().write_all(text.as_bytes())?)
}
