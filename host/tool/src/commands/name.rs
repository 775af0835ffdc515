//! `haptic name`: what a board is called.

use super::answer::Json;
use super::port::Port;
use haptic_host::error::{Failure, on_one_line};
use serde_json::json;

/// Show what a board is called, or call it something else
///
/// A name tells boards apart in `haptic info` and in backups. `haptic save` keeps it over a power cycle.
#[derive(clap::Args)]
pub struct Args {
    #[command(flatten)]
    port: Port,
    /// The new name, at most 32 bytes; "" takes the name away
    name: Option<String>,
    #[command(flatten)]
    json: Json,
}

/// Shows or sets the name.
pub fn run(args: Args) -> Result<(), Failure> {
    let Some(name) = &args.name else {
        let name = args.port.open()?.details()?.name;
        let said =
            if name.is_empty() { "this board has no name\n".into() } else { format!("{}\n", on_one_line(&name)) };
        return args.json.answer(json!({ "name": name }), &said);
    };
    if name.chars().any(char::is_control) {
        return Err(Failure::wrong("a name of a board is one line of text").remedy("leave control characters out"));
    }
    let short = name.as_str().try_into().map_err(|_| {
        Failure::wrong(format!("`{name}` takes {} bytes", name.len())).remedy("a board keeps names of at most 32 bytes")
    })?;
    args.port.open()?.set_name(&short)?;
    let said = if name.is_empty() {
        "this board has no name now; `haptic save` makes that last\n".into()
    } else {
        format!("this board is called {name}; `haptic save` keeps the name over a power cycle\n")
    };
    args.json.answer(json!({ "name": name }), &said)
}
