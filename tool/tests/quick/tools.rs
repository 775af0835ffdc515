//! Tools that connect second, leave, are killed, flood the board or stay silent. One tool at a time uses the board, the
//! next tool finds the board unchanged, and a request to disarm always arrives. No test depends on time.

use crate::common::prelude::*;
use crate::common::{board, measurement, shipped_device, shipped_path};
use haptic_bridge::board::protocol::{Disarm, GetDetails, GetInfo, Info, PROTOCOL};
use haptic_host::link::{Deframer, LinkError, PortSpec, Wire, disarm_held_board, encode};
use haptic_predict::measure::{MeasureError, PreparedBoard};
use haptic_sim::door::{Patience, ToolListener, tcp};
use haptic_sim::server::{Pace, serve};
use haptic_sim::{SimulatedBoard, ready_board};
use postcard_rpc::Endpoint;
use postcard_rpc::header::{VarHeader, VarKey, VarSeq};
use std::cell::Cell;
use std::io::{Read, Write};
use std::net::{Shutdown, TcpListener, TcpStream};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::{JoinHandle, spawn};
use std::time::Duration;

const NO_WAIT: Duration = Duration::ZERO;
const AN_HOUR: Duration = Duration::from_secs(3600);

fn device() -> DeviceFile {
    shipped_device("coupled-five-bar")
}

fn simulated_board() -> SimulatedBoard {
    ready_board(&device(), BoardOptions::default()).unwrap()
}

/// A simulated board behind a port; ends when dropped.
struct ServedBoard {
    port: PortSpec,
    stop: Arc<AtomicBool>,
    server: Option<JoinHandle<()>>,
}

impl ServedBoard {
    fn start(door: ToolListener) -> Self {
        let (port, stop) = (door.port.parse().unwrap(), Arc::new(AtomicBool::new(false)));
        let stopped = Arc::clone(&stop);
        let server = spawn(move || serve(&mut simulated_board(), &door, Pace::AsFastAsItCan, &stopped));
        Self { port, stop, server: Some(server) }
    }

    /// Serves over TCP. A new tool waits up to `handover` until the old one leaves, or replaces it after `silence`.
    fn on_tcp(handover: Duration, silence: Duration) -> Self {
        Self::start(tcp("127.0.0.1:0".parse().unwrap(), Patience { silence, handover }).unwrap())
    }

    /// Serves boards over every kind of port.
    fn on_every_port(handover: Duration) -> Vec<Self> {
        let mut ports = vec![Self::on_tcp(handover, AN_HOUR)];
        #[cfg(unix)]
        ports.push(Self::start(haptic_sim::door::pseudo_terminal().unwrap()));
        ports
    }

    fn open(&self) -> Board {
        Board::open(&self.port).unwrap_or_else(|error| panic!("{:?}: {error}", self.port))
    }

    /// Returns a board with its motors on.
    fn open_armed(&self) -> Board {
        let mut board = self.open();
        board.set_scene(&Scene { task: 2, ..Scene::default() }).unwrap();
        board.arm().unwrap();
        board
    }

    /// Opens a connection that sends nothing.
    fn connect(&self) -> TcpStream {
        let PortSpec::Tcp(address) = &self.port else { panic!("{:?} is no TCP port", self.port) };
        TcpStream::connect(address).unwrap()
    }

    fn assert_refuses_second_tool(&self) {
        let error = Board::open(&self.port).map(drop).unwrap_err();
        let message = error.to_string();
        match (&error, &self.port) {
            (LinkError::HeldByAnother(_), PortSpec::Tcp(address)) => assert!(message.contains(address), "{message}"),
            (LinkError::PortBusy(_), PortSpec::Serial(name)) => assert!(message.contains(name), "{message}"),
            _ => panic!("{message}"),
        }
        assert!(message.contains("another"), "{message}");
    }
}

impl Drop for ServedBoard {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::SeqCst);
        let _ = self.server.take().map(JoinHandle::join);
    }
}

/// Reads telemetry until `count` more rows have arrived.
fn read_rows(board: &mut Board, count: u64) {
    let enough = board.losses().received + count;
    while board.losses().received < enough {
        board.rows(Duration::from_secs(1)).unwrap();
    }
}

#[test]
fn two_tools_in_a_row_stream_without_loss() {
    for served in ServedBoard::on_every_port(AN_HOUR) {
        for _ in 0..2 {
            let mut board = served.open();
            assert_eq!(board.info().board.as_str(), "simulated");
            assert_eq!(board.details().unwrap().device.as_deref(), Some("coupled-five-bar"));
            board.start_stream(fields("usual").unwrap(), 10).unwrap();
            read_rows(&mut board, 5_000);
            assert_eq!((board.losses().missing, board.losses().garbled), (0, 0));
        }
    }
}

#[test]
fn a_second_tool_is_refused_without_disturbing_the_first() {
    for served in ServedBoard::on_every_port(NO_WAIT) {
        let mut first = served.open();
        first.start_stream(fields("usual").unwrap(), 10).unwrap();
        read_rows(&mut first, 500);
        served.assert_refuses_second_tool();
        read_rows(&mut first, 5_000);
        assert_eq!((first.losses().missing, first.losses().garbled), (0, 0));
    }
}

#[test]
fn a_request_to_disarm_arrives_at_a_board_that_is_in_use() {
    for served in ServedBoard::on_every_port(NO_WAIT) {
        // Meanwhile the first tool does not read, as if its process were stopped.
        let mut first = served.open_armed();
        disarm_held_board(&served.port).unwrap();
        assert_eq!(first.status().unwrap().state, State::Disarmed);
        // No other request of a second tool is accepted.
        first.arm().unwrap();
        served.assert_refuses_second_tool();
        assert_eq!(first.status().unwrap().state, State::Armed);
    }
}

#[test]
fn silent_connections_do_not_block_a_request_to_disarm() {
    let server = ServedBoard::on_tcp(NO_WAIT, AN_HOUR);
    let mut first = server.open_armed();
    let silent = || (0..100).map(|_| server.connect()).collect::<Vec<_>>();
    // Like `haptic disarm`, first connect normally, which is refused because the board is in use.
    let _crowd = silent();
    server.assert_refuses_second_tool();
    let _more = silent();
    assert_eq!(first.status().unwrap().state, State::Armed);
    disarm_held_board(&server.port).unwrap();
    assert_eq!(first.status().unwrap().state, State::Disarmed);
}

#[test]
fn partial_requests_do_not_block_a_request_to_disarm() {
    let server = ServedBoard::on_tcp(AN_HOUR, AN_HOUR);
    let mut first = server.open_armed();
    let strangers = (0..100).map(|_| {
        let mut stranger = server.connect();
        // The write may fail, because a refused connection is closed.
        let _ = stranger.write_all(&[1]);
        stranger
    });
    let _crowd: Vec<_> = strangers.collect();
    disarm_held_board(&server.port).unwrap();
    assert_eq!(first.status().unwrap().state, State::Disarmed);
}

#[test]
fn a_tool_replaces_silent_connections() {
    let server = ServedBoard::on_tcp(AN_HOUR, NO_WAIT);
    let _silent: Vec<_> = (0..100).map(|_| server.connect()).collect();
    let mut board = server.open();
    // The silent connections do not get the board back.
    for _ in 0..100 {
        board.status().unwrap();
    }
}

fn request<E: Endpoint>(sequence: u16) -> Vec<u8> {
    encode(&VarHeader { key: VarKey::Key8(E::REQ_KEY), seq_no: VarSeq::Seq2(sequence) }, &[])
}

#[test]
fn a_flooding_tool_costs_bounded_memory_and_is_replaced() {
    let mut board = simulated_board();
    (0..50_000).for_each(|sequence| board.receive(&request::<GetDetails>(sequence)));
    let (mut waiting, mut buffer) = (0, [0; 4096]);
    loop {
        match board.take_bytes(&mut buffer) {
            0 => break,
            count => waiting += count,
        }
    }
    assert!(waiting > 10_000, "the board replied with only {waiting} bytes");
    let room = BoardOptions::default().send_buffer + 70_000;
    assert!(waiting < room, "{waiting} bytes wait for a tool that does not read");
    let server = ServedBoard::on_tcp(AN_HOUR, AN_HOUR);
    let mut flood = server.connect();
    let requests: Vec<u8> = (0..20_000).flat_map(request::<GetDetails>).collect();
    flood.write_all(&requests).unwrap();
    drop(flood);
    server.open().status().unwrap();
}

#[test]
fn a_board_arms_again_after_a_hundred_armed_reconnections() {
    let server = ServedBoard::on_tcp(AN_HOUR, AN_HOUR);
    let mut board = server.open_armed();
    board.disarm().unwrap();
    let host_seconds = Rules::HOST_SECONDS.1;
    board.set_rules(&Rules { host_action: HostAction::Disarm, host_seconds, ..Rules::default() }).unwrap();
    drop(board);
    for round in 0..100 {
        let mut board = server.open();
        board.keep_alive();
        // After a tool that left without disarming, the motors are still on.
        board.disarm().unwrap();
        board.arm().unwrap();
        board.start_stream(fields("usual").unwrap(), 10).unwrap();
        read_rows(&mut board, 50);
        assert_eq!(board.losses().missing, 0, "round {round}");
        assert_eq!(board.status().unwrap().state, State::Armed, "round {round}");
        if round % 2 == 0 {
            board.disarm().unwrap();
        }
    }
    assert_eq!(server.open().faults().unwrap().len(), 0);
}

#[test]
fn losing_the_board_while_streaming_is_a_clear_error() {
    let server = ServedBoard::on_tcp(AN_HOUR, AN_HOUR);
    let cable = TcpListener::bind("127.0.0.1:0").unwrap();
    let port = PortSpec::Tcp(cable.local_addr().unwrap().to_string());
    let mut to_board = server.connect();
    // Cut the connection after 2000 bytes from the board.
    let relay = spawn(move || {
        let (mut tool, _) = cable.accept().unwrap();
        let (mut from_board, mut from_tool) = (to_board.try_clone().unwrap(), tool.try_clone().unwrap());
        spawn(move || std::io::copy(&mut from_tool, &mut to_board));
        std::io::copy(&mut Read::by_ref(&mut from_board).take(2000), &mut tool).unwrap();
        let _ = (tool.shutdown(Shutdown::Both), from_board.shutdown(Shutdown::Both));
    });
    let mut board = Board::open(&port).unwrap();
    board.start_stream(fields("all").unwrap(), 100).unwrap();
    let error = loop {
        if let Err(error) = board.rows(Duration::from_secs(1)) {
            break error;
        }
    };
    relay.join().unwrap();
    assert!(matches!(error, LinkError::Lost(_)) && error.to_string().contains("unplugged"), "{error}");
    assert!(board.losses().received > 5);
}

#[test]
fn ports_without_a_board_are_named() {
    // The port of an outgoing connection is in use, but nothing listens on it.
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let connection = TcpStream::connect(listener.local_addr().unwrap()).unwrap();
    let address = connection.local_addr().unwrap().to_string();
    let error = Board::open(&PortSpec::Tcp(address.clone())).map(drop).unwrap_err();
    assert!(matches!(error, LinkError::NotListening { .. }) && error.to_string().contains(&address), "{error}");
    let error = Board::open(&PortSpec::Serial("/dev/no-such-port".into())).map(drop).unwrap_err();
    assert!(matches!(error, LinkError::NoSuchPort { .. }), "{error}");
    assert!(error.to_string().contains("/dev/no-such-port"));
}

/// A device that is not a board (`protocol` is `None`), or a board with another protocol version.
struct UnknownDevice {
    protocol: Option<u16>,
    out: Vec<u8>,
    now: Duration,
}

impl UnknownDevice {
    fn connect_error(protocol: Option<u16>) -> LinkError {
        let wire = Self { protocol, out: b"HTTP/1.1 400 Bad Request\r\n\r\n\0\0".into(), now: Duration::ZERO };
        Board::over(Box::new(wire), "test").map(drop).unwrap_err()
    }
}

impl Wire for UnknownDevice {
    fn send(&mut self, bytes: &[u8]) -> std::io::Result<()> {
        let mut requests = Vec::new();
        Deframer::default().feed(bytes, |frame| requests.push(frame));
        for request in requests {
            assert_eq!(request.header.key, VarKey::Key8(GetInfo::REQ_KEY), "a request to an unknown board");
            let Some(protocol) = self.protocol else { continue };
            let (firmware, board) = ("9.9".chars().collect(), "odrive-v3".chars().collect());
            let info = Info { protocol, firmware, board, serial: "A1".chars().collect() };
            let header = VarHeader { key: VarKey::Key8(GetInfo::RESP_KEY), seq_no: request.header.seq_no };
            self.out.extend(encode(&header, &postcard::to_stdvec(&info).unwrap()));
        }
        Ok(())
    }
    fn receive(&mut self, buffer: &mut [u8], timeout: Duration) -> std::io::Result<usize> {
        let count = self.out.len().min(buffer.len());
        buffer[..count].copy_from_slice(&self.out[..count]);
        self.out.drain(..count);
        self.now += if count == 0 { timeout } else { Duration::ZERO };
        assert!(self.now <= Duration::from_secs(2), "the tool must give up within 2 s");
        Ok(count)
    }
    fn now(&self) -> Duration {
        self.now
    }
}

#[test]
fn unknown_boards_receive_no_further_requests() {
    let error = UnknownDevice::connect_error(None);
    assert!(matches!(error, LinkError::Silent { .. }), "{error}");
    for (protocol, remedy) in [(PROTOCOL + 1, "update this tool"), (PROTOCOL - 1, "flash it: haptic flash")] {
        let error = UnknownDevice::connect_error(Some(protocol));
        assert!(matches!(error, LinkError::Version { board, tool: PROTOCOL } if board == protocol), "{error}");
        assert!(error.to_string().contains(remedy), "{error}");
    }
}

/// Returns a board in this process, in virtual time.
fn board_in_process() -> (SharedBoard, Board) {
    board(&device(), BoardOptions::default())
}

#[test]
fn rows_of_a_killed_tools_stream_are_discarded() {
    let (shared, mut killed) = board_in_process();
    killed.start_stream(fields("counts").unwrap(), 1).unwrap();
    shared.lock().run(0.2);
    // The killed tool has read nothing, so its rows still wait at the port for the next tool.
    drop(killed);
    let mut next_board = Board::over(shared.wire(), "sim").unwrap();
    next_board.start_stream(fields("q,tip").unwrap(), 20).unwrap();
    let mut rows = Vec::new();
    while rows.len() < 100 {
        rows.extend(next_board.rows(Duration::from_millis(100)).unwrap());
    }
    assert!(rows.iter().all(|row| row.values.len() == 4), "{:?}", rows[0]);
    assert!(rows.windows(2).all(|pair| pair[1].step - pair[0].step == 20));
    let losses = next_board.losses();
    assert_eq!((losses.missing, losses.batches_lost, losses.garbled), (0, 0, 0));
}

/// Runs one trial of a measurement, which calls `stop` again and again.
fn measure(board: &mut Board, stop: &dyn Fn() -> bool) -> Result<(), MeasureError> {
    let mut prepared = PreparedBoard::new(board, &device(), measurement(&[0.6, 0.8], 1_000.0, 20.0), stop)?;
    prepared.oscillates(FeedForward::Off, 100.0, 1.0, 1.0).map(drop)
}

#[test]
fn a_stopped_measurement_turns_motors_off_and_restores_rules() {
    let (shared, mut board) = board_in_process();
    let scene =
        SceneFile::load(Path::new(&shipped_path("scenes/coupled-five-bar/wall.toml")), 2).unwrap().scene().unwrap();
    board.set_scene(&scene).unwrap();
    let before = board.rules().unwrap();
    for most in [1, 30, 300, 1000] {
        let call_count = Cell::new(0);
        let result = measure(&mut board, &|| {
            call_count.set(call_count.get() + 1);
            call_count.get() > most
        });
        assert_eq!(result.is_err(), call_count.get() > most, "{result:?}");
        assert_eq!(shared.lock().status().state, State::Disarmed, "after {most}");
        assert_eq!(board.rules().unwrap(), before);
        assert_eq!(board.scene().unwrap().as_ref(), Some(&scene));
    }
}

#[test]
fn a_measurement_ends_when_another_tool_disarms() {
    for most in [40, 60] {
        let (shared, mut board) = board_in_process();
        let call_count = Cell::new(0);
        let result = measure(&mut board, &|| {
            call_count.set(call_count.get() + 1);
            if call_count.get() == most {
                shared.lock().receive(&request::<Disarm>(7));
            }
            false
        });
        assert!(call_count.get() >= most, "the measurement ended before the disarm request");
        assert!(matches!(result, Err(MeasureError::Disarmed)), "{result:?}");
        assert_eq!(shared.lock().status().state, State::Disarmed);
    }
}

#[test]
fn the_motors_go_off_if_the_measuring_tool_dies() {
    let (shared, mut board) = board_in_process();
    let prepared =
        PreparedBoard::new(&mut board, &device(), measurement(&[0.6, 0.8], 1_000.0, 20.0), &|| false).unwrap();
    // A killed process does not drop anything.
    std::mem::forget(prepared);
    assert_eq!(shared.lock().status().state, State::Armed);
    shared.lock().run(1.1);
    let status = shared.lock().status();
    assert_eq!((status.state, status.fault.map(|record| record.fault)), (State::Fault, Some(Fault::HostLost)));
}
