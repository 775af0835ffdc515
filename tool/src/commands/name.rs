//! `haptic board name`: shows or sets the name of a board.

use super::port::OnBoard;
use haptic_host::error::{Failure, on_one_line};
use serde_json::json;

/// Show or set the name of a board
///
/// The name distinguishes boards in `haptic info` and in backups. `haptic board save` keeps it over a power cycle.
#[derive(clap::Args)]
pub struct Args {
    #[command(flatten)]
    on: OnBoard,
    /// New name, at most 32 bytes; "" removes the name
    name: Option<String>,
}

pub fn run(args: Args) -> Result<(), Failure> {
    let Some(name) = &args.name else {
        let name = args.on.open()?.details()?.name;
        let words =
            if name.is_empty() { "this board has no name\n".into() } else { format!("{}\n", on_one_line(&name)) };
        return args.on.answer(json!({ "name": name }), &words);
    };
    if name.chars().any(char::is_control) {
        return Err(Failure::wrong("the name of a board is one line of text").remedy("leave control characters out"));
    }
    let short = name.as_str().try_into().map_err(|_| {
        Failure::wrong(format!("`{name}` takes {} bytes", name.len())).remedy("a board keeps names of at most 32 bytes")
    })?;
    args.on.open()?.set_name(&short)?;
    let words = if name.is_empty() {
        "this board has no name now; `haptic board save` keeps it so over a power cycle\n".into()
    } else {
        format!("this board is called {name}; `haptic board save` keeps the name over a power cycle\n")
    };
    args.on.answer(json!({ "name": name }), &words)
}
