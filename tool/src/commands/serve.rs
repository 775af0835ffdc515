//! `haptic serve`: offers a board to programs that were made for other devices.

use super::interrupt;
use super::port::Port;
use haptic_host::error::{Failure, print};
use haptic_host::frame::Axes;
use haptic_host::link::{PortSpec, Session};
use haptic_show::haply::{DEFAULT_PORT, HaplyListener, Inverse3};

/// Let programs that were made for other devices use a board
///
/// --haply provides the interface of Haply's inverse service until Ctrl-C: a WebSocket with JSON, only on this
/// computer. The first force of a program arms the board; the motors go off when the program leaves, and its forces
/// fade when it sends nothing. If the board is unplugged, the command waits for it.
#[derive(clap::Args)]
pub struct Args {
    /// Act as Haply's inverse service: an Inverse3 and a grip that does not move
    #[arg(long, required = true)]
    haply: bool,
    /// Port to listen on, on this computer; 0 takes a free one
    #[arg(long, value_name = "PORT", default_value_t = DEFAULT_PORT)]
    listen: u16,
    /// Axes of the device towards the operator, to the right and up [default: by the mechanism, docs/chai3d.md]
    #[arg(long, value_name = "AXES", allow_hyphen_values = true)]
    axes: Option<Axes>,
    #[command(flatten)]
    port: Port,
}

pub fn run(args: Args) -> Result<(), Failure> {
    let stop = interrupt::watch();
    let simulated = matches!(args.port.spec(), PortSpec::Sim(_));
    let open =
        || -> Result<Inverse3, Failure> { Ok(Inverse3::new(Session::of(args.port.open()?), args.axes, simulated)?) };
    let device = open()?;
    let listener = HaplyListener::open(args.listen).map_err(|error| {
        Failure::impossible(format!("cannot listen on port {}: {error}", args.listen))
            .remedy("end the program that listens there, such as Haply's own service, or choose another --listen PORT")
    })?;
    let url = listener.url().map_err(Failure::impossible)?;
    let page = listener.url_for_pages().map_err(Failure::impossible)?;
    print(&format!(
        "{} is an Inverse3 for programs, at {url}\na page in a browser here uses {page}\nCtrl-C ends it\n",
        device.id()
    ))?;
    listener.serve(device, open, stop.flag());
    Ok(())
}
