//! The `kincal` binary: everything it does is in [`kincal::cli`].

fn main() -> std::process::ExitCode {
    kincal::cli::main()
}
