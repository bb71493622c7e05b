//! `planish completions`: scripts that complete commands, options and files in a shell.

use crate::summary::print_document;
use clap::Args;

const EXAMPLES: &str = "\
Examples:
  planish completions bash
  planish completions zsh
  planish completions fish

The script goes to stdout. Save it where the shell looks for completions:
  bash  ~/.local/share/bash-completion/completions/planish
  zsh   _planish, in a folder of fpath
  fish  ~/.config/fish/completions/planish.fish";

/// Arguments of `planish completions`.
#[derive(Debug, Args)]
#[command(after_help = EXAMPLES)]
pub struct CompletionsArgs {
    /// Shell to write the script for
    #[arg(value_name = "SHELL", value_enum)]
    shell: clap_complete::Shell,
}

/// Prints the completion script for `command`; returns the exit code.
pub fn run(args: &CompletionsArgs, mut command: clap::Command) -> u8 {
    let mut script = Vec::new();
    // Into memory, because this function panics if it cannot write, as to a closed pipe.
    clap_complete::generate(args.shell, &mut command, "planish", &mut script);
    print_document("completions", Ok(script))
}
