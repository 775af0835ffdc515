//! `haptic board name`: what a board is called.

use super::port::OnBoard;
use haptic_host::error::{Failure, on_one_line};
use serde_json::json;

/// Show what a board is called, or call it something else
///
/// A name tells boards apart in `haptic info` and in backups. `haptic board save` keeps it over a power cycle.
#[derive(clap::Args)]
pub struct Args {
    #[command(flatten)]
    on: OnBoard,
    /// The new name, at most 32 bytes; "" takes the name away
    name: Option<String>,
}

/// Shows or sets the name.
pub fn run(args: Args) -> Result<(), Failure> {
    let Some(name) = &args.name else {
        let name = args.on.open()?.details()?.name;
        let said =
            if name.is_empty() { "this board has no name\n".into() } else { format!("{}\n", on_one_line(&name)) };
        return args.on.answer(json!({ "name": name }), &said);
    };
    if name.chars().any(char::is_control) {
        return Err(Failure::wrong("a name of a board is one line of text").remedy("leave control characters out"));
    }
    let short = name.as_str().try_into().map_err(|_| {
        Failure::wrong(format!("`{name}` takes {} bytes", name.len())).remedy("a board keeps names of at most 32 bytes")
    })?;
    args.on.open()?.set_name(&short)?;
    let said = if name.is_empty() {
        "this board has no name now; `haptic board save` makes that last\n".into()
    } else {
        format!("this board is called {name}; `haptic board save` keeps the name over a power cycle\n")
    };
    args.on.answer(json!({ "name": name }), &said)
}
