//! `sparrowhawk recover`: what can be read of a damaged log, as a whole one.

use crate::say::tell;
use clap::Args;
use std::error::Error;
use std::path::PathBuf;
use std::process::ExitCode;

/// What to recover.
#[derive(Debug, Args)]
pub(crate) struct RecoverArguments {
    /// The log (MCAP): of a recorder that was killed, say.
    log: PathBuf,
    /// The whole one, which must not exist yet; beside the log, with `.recovered` in its name, if not given.
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
}

pub(crate) fn recover(arguments: &RecoverArguments) -> Result<ExitCode, Box<dyn Error>> {
    let out = arguments.out.clone().unwrap_or_else(|| arguments.log.with_extension("recovered.mcap"));
    let recovered = recorder::recover(&arguments.log, &out)?;
    for (topic, messages) in &recovered.messages {
        tell!("{messages:9} {topic}");
    }
    tell!(
        "{}: {} messages and {} attachments",
        out.display(),
        recovered.messages.values().sum::<u64>(),
        recovered.attachments
    );
    match recovered.damage.is_none() {
        true => tell!("{} was whole", arguments.log.display()),
        false => tell!("{}: {}", arguments.log.display(), recovered.damage),
    }
    Ok(ExitCode::SUCCESS)
}
