//! Tools that are silent, flood, or come second: the board serves the next one, and a request to disarm gets through.

use haptic::device_file::DeviceFile;
use haptic::link::{Board, LinkError, PortSpec, disarm_past, encode};
use haptic::sim::door::{ToolListener, tcp};
use haptic::sim::server::{Pace, serve};
use haptic::sim::{BoardOptions, SHIPPED_DEVICE, SimulatedBoard, ready_board};
use haptic_bridge::board::protocol::GetDetails;
use haptic_bridge::render::scene::Scene;
use haptic_bridge::safety::fault::State;
use postcard_rpc::Endpoint;
use postcard_rpc::header::{VarHeader, VarKey, VarSeq};
use std::io::Write;
use std::net::TcpStream;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

fn simulated() -> SimulatedBoard {
    let file = DeviceFile::parse(SHIPPED_DEVICE, "coupled-five-bar.toml").unwrap();
    ready_board(&file, BoardOptions::default()).unwrap()
}

/// Serves a board until the test ends; its port, and what ends it.
fn served(door: ToolListener) -> (PortSpec, Stop) {
    let port = door.port.parse().unwrap();
    let stop = Stop(Arc::new(AtomicBool::new(false)));
    let stopped = Arc::clone(&stop.0);
    std::thread::spawn(move || serve(&mut simulated(), &door, Pace::RealTime, &stopped));
    (port, stop)
}

struct Stop(Arc<AtomicBool>);
impl Drop for Stop {
    fn drop(&mut self) {
        self.0.store(true, Ordering::SeqCst);
    }
}

fn on_tcp() -> (PortSpec, Stop) {
    served(tcp("127.0.0.1:0".parse().unwrap()).unwrap())
}

fn connect(port: &PortSpec) -> TcpStream {
    let PortSpec::Tcp(address) = port else { panic!("{port:?} is no TCP port") };
    TcpStream::connect(address).unwrap()
}

/// Opens the board, trying again while another tool holds it; how long that took.
fn open_in_turn(port: &PortSpec) -> (Board, Duration) {
    let began = Instant::now();
    while began.elapsed() < Duration::from_secs(30) {
        match Board::open(port) {
            Ok(board) => return (board, began.elapsed()),
            Err(LinkError::HeldByAnother(_) | LinkError::Lost(_) | LinkError::Silent { .. }) => {}
            Err(other) => panic!("{other}"),
        }
    }
    panic!("the board was never free");
}

fn armed(board: &mut Board) {
    board.set_scene(&Scene { task: 2, ..Scene::default() }).unwrap();
    board.arm().unwrap();
    assert_eq!(board.status().unwrap().state, State::Armed);
}

fn request(sequence: u16) -> Vec<u8> {
    let header = VarHeader { key: VarKey::Key8(GetDetails::REQ_KEY), seq_no: VarSeq::Seq2(sequence) };
    encode(&header, &[])
}

#[test]
fn a_connection_that_says_nothing_gives_way_to_a_tool() {
    let (port, _stop) = on_tcp();
    let _silent = connect(&port);
    std::thread::sleep(Duration::from_millis(100));
    let (mut board, waited) = open_in_turn(&port);
    board.status().unwrap();
    // Three seconds of silence, and the slack of a busy computer.
    assert!(waited < Duration::from_secs(15), "{waited:?}");
}

#[test]
fn many_silent_connections_neither_disturb_the_first_tool_nor_block_the_next() {
    let (port, _stop) = on_tcp();
    let mut first = Board::open(&port).unwrap();
    let silent: Vec<TcpStream> = (0..200).map(|_| connect(&port)).collect();
    for _ in 0..20 {
        first.status().unwrap();
        std::thread::sleep(Duration::from_millis(20));
    }
    drop(first);
    let (mut next, waited) = open_in_turn(&port);
    next.status().unwrap();
    assert!(waited < Duration::from_secs(20), "{waited:?}");
    drop(silent);
}

#[test]
fn a_tool_that_floods_and_does_not_read_costs_a_bounded_memory() {
    let mut board = simulated();
    for sequence in 0..50_000_u16 {
        board.receive(&request(sequence));
    }
    let (mut waiting, mut buffer) = (0, [0; 4096]);
    loop {
        match board.take_bytes(&mut buffer) {
            0 => break,
            count => waiting += count,
        }
    }
    assert!(waiting > 10_000, "it did answer: {waiting} bytes");
    let room = BoardOptions::default().send_buffer + 70_000;
    assert!(waiting < room, "{waiting} bytes wait for a tool that does not read");
}

#[test]
fn the_next_tool_is_served_soon_after_a_flood() {
    let (port, _stop) = on_tcp();
    let mut flood = connect(&port);
    flood.set_write_timeout(Some(Duration::from_millis(500))).unwrap();
    let requests: Vec<u8> = (0..500).flat_map(request).collect();
    let began = Instant::now();
    let mut sent = 0;
    while began.elapsed() < Duration::from_secs(2) && flood.write_all(&requests).is_ok() {
        sent += requests.len();
    }
    assert!(sent > 100_000, "{sent} bytes sent");
    drop(flood);
    let (mut board, waited) = open_in_turn(&port);
    board.status().unwrap();
    assert!(waited < Duration::from_secs(15), "{waited:?}");
}

#[test]
fn a_request_to_disarm_gets_past_the_tool_that_holds_the_board_over_tcp() {
    let (port, _stop) = on_tcp();
    let mut first = Board::open(&port).unwrap();
    armed(&mut first);
    disarm_past(&port).unwrap();
    assert_eq!(first.status().unwrap().state, State::Disarmed);
    // And nothing but that request does.
    armed(&mut first);
    assert!(matches!(Board::open(&port).map(drop), Err(LinkError::HeldByAnother(_))));
    assert_eq!(first.status().unwrap().state, State::Armed);
}

#[test]
fn a_request_to_disarm_gets_past_forty_connections_that_say_nothing() {
    let (port, _stop) = on_tcp();
    let mut first = Board::open(&port).unwrap();
    armed(&mut first);
    let silent: Vec<TcpStream> = (0..40).map(|_| connect(&port)).collect();
    // As `haptic disarm` does: it asks first, and is told that the board is held.
    let told = Board::open(&port).map(drop);
    assert!(matches!(told, Err(LinkError::HeldByAnother(_))), "{told:?}");
    let more: Vec<TcpStream> = (0..40).map(|_| connect(&port)).collect();
    disarm_past(&port).unwrap();
    assert_eq!(first.status().unwrap().state, State::Disarmed);
    drop((silent, more));
}

#[cfg(unix)]
#[test]
fn a_request_to_disarm_gets_past_the_tool_that_holds_a_pseudo_terminal() {
    let (port, _stop) = served(haptic::sim::door::pseudo_terminal().unwrap());
    let mut first = Board::open(&port).unwrap();
    armed(&mut first);
    assert!(matches!(Board::open(&port).map(drop), Err(LinkError::PortBusy(_))), "it is held");
    // The first tool does not read meanwhile, as one that was stopped.
    disarm_past(&port).unwrap();
    assert_eq!(first.status().unwrap().state, State::Disarmed);
}
