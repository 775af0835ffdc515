//! Boards behind real ports: a pseudo-terminal and TCP, a second tool, a board that goes away.

use haptic::device_file::DeviceFile;
use haptic::link::{Board, Deframer, LinkError, PortSpec, Wire, encode, fields};
use haptic::sim::door::{ToolListener, tcp};
use haptic::sim::server::{Hosted, Pace, serve};
use haptic::sim::{BoardOptions, SHIPPED_DEVICE, SimulatedBoard, ready_board};
use haptic_bridge::board::protocol::{GetInfo, Info, PROTOCOL};
use haptic_bridge::render::scene::Scene;
use haptic_bridge::safety::fault::{Fault, State};
use haptic_bridge::servo::{HostAction, Rules};
use postcard_rpc::Endpoint;
use postcard_rpc::header::{VarHeader, VarKey};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::{JoinHandle, spawn};
use std::time::{Duration, Instant};

/// A simulated board being served; stops when dropped.
struct Served {
    port: PortSpec,
    stop: Arc<AtomicBool>,
    server: Option<JoinHandle<Option<ToolListener>>>,
}

impl Served {
    fn new(door: ToolListener, pace: Pace) -> Self {
        let port = door.port.parse().unwrap();
        let stop = Arc::new(AtomicBool::new(false));
        let stopped = Arc::clone(&stop);
        let server = spawn(move || {
            let file = DeviceFile::parse(SHIPPED_DEVICE, "coupled-five-bar.toml").unwrap();
            let mut board = ready_board(&file, BoardOptions::default()).unwrap();
            serve(&mut board, &door, pace, &stopped);
            Some(door)
        });
        Self { port, stop, server: Some(server) }
    }

    fn on_tcp(pace: Pace) -> Self {
        Self::new(tcp("127.0.0.1:0".parse().unwrap()).unwrap(), pace)
    }

    fn open(&self) -> Result<Board, LinkError> {
        Board::open(&self.port)
    }

    /// Opens the port again, giving the server the moment it needs to notice that the last tool has gone.
    fn reopen(&self) -> Board {
        for _ in 0..500 {
            match self.open() {
                Ok(board) => return board,
                Err(LinkError::HeldByAnother(_) | LinkError::Lost(_) | LinkError::PortBusy(_)) => {
                    std::thread::sleep(Duration::from_millis(10));
                }
                Err(other) => panic!("{other}"),
            }
        }
        panic!("the port never became free");
    }
}

impl Drop for Served {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::SeqCst);
        if let Some(server) = self.server.take() {
            let _ = server.join();
        }
    }
}

/// Streams until `count` rows have come and returns the number of rows received.
fn stream(board: &mut Board, count: usize) -> usize {
    board.start_stream(fields("usual").unwrap(), 10).unwrap();
    let mut rows = 0;
    while rows < count {
        rows += board.rows(Duration::from_secs(10)).unwrap().len();
    }
    board.stop_stream().unwrap();
    rows
}

#[test]
fn a_board_behind_tcp_answers_and_streams_without_loss() {
    let served = Served::on_tcp(Pace::AsFastAsItCan);
    let mut board = served.open().unwrap();
    assert_eq!(board.info().board.as_str(), "simulated");
    assert_eq!(board.details().unwrap().device.as_deref(), Some("coupled-five-bar"));
    let rows = stream(&mut board, 20_000);
    let losses = board.losses();
    assert_eq!((losses.received, losses.missing, losses.garbled), (rows as u64, 0, 0));
}

#[test]
fn a_second_tool_is_told_that_the_board_is_taken() {
    let served = Served::on_tcp(Pace::RealTime);
    let mut first = served.open().unwrap();
    match served.open() {
        Err(LinkError::HeldByAnother(port)) => assert!(port.starts_with("tcp:127.0.0.1:")),
        Err(other) => panic!("{other}"),
        Ok(_) => panic!("two tools on one board"),
    }
    first.status().unwrap();
    drop(first);
    served.reopen().status().unwrap();
}

#[test]
fn a_hundred_replugs_armed_or_not_leave_a_board_that_arms_again() {
    let served = Served::on_tcp(Pace::RealTime);
    let mut board = served.open().unwrap();
    board.set_scene(&Scene { task: 2, ..Scene::default() }).unwrap();
    board.set_rules(&Rules { host_action: HostAction::Disarm, host_seconds: 1.0, ..Rules::default() }).unwrap();
    drop(board);
    for round in 0..100 {
        let mut board = served.reopen();
        board.keep_alive();
        // A tool that left without disarming took the motors with it, or takes them now.
        if board.status().unwrap().state != State::Disarmed {
            board.disarm().unwrap();
            board.clear().unwrap();
        }
        board.arm().unwrap();
        let rows = stream(&mut board, 50);
        assert_eq!((board.losses().received, board.losses().missing), (rows as u64, 0), "round {round}");
        assert_eq!(board.status().unwrap().state, State::Armed, "round {round}");
        if round % 2 == 0 {
            board.disarm().unwrap();
        }
    }
    let mut board = served.reopen();
    let seen = board.faults().unwrap();
    assert!(seen.iter().all(|record| record.fault == Fault::HostLost), "{seen:?}");
}

#[test]
fn a_board_that_goes_away_while_streaming_is_a_clear_error() {
    let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let port = PortSpec::Tcp(listener.local_addr().unwrap().to_string());
    let served = Served::on_tcp(Pace::RealTime);
    let PortSpec::Tcp(behind) = served.port.clone() else { panic!("TCP") };
    // A cable that can be pulled: passes 2000 bytes from the board, then closes.
    let cable = spawn(move || {
        let (mut tool, _) = listener.accept().unwrap();
        let mut board = std::net::TcpStream::connect(behind).unwrap();
        let (mut from_tool, mut to_board) = (tool.try_clone().unwrap(), board.try_clone().unwrap());
        spawn(move || std::io::copy(&mut from_tool, &mut to_board));
        let passed = std::io::copy(&mut std::io::Read::take(&mut board, 2000), &mut tool);
        let _ = tool.shutdown(std::net::Shutdown::Both);
        let _ = board.shutdown(std::net::Shutdown::Both);
        passed
    });
    let mut board = Board::open(&port).unwrap();
    board.start_stream(fields("all").unwrap(), 100).unwrap();
    let mut received = 0;
    let error = loop {
        match board.rows(Duration::from_secs(10)) {
            Ok(rows) => received += rows.len(),
            Err(error) => break error,
        }
    };
    assert!(matches!(error, LinkError::Lost(_)), "{error}");
    assert!(error.to_string().contains("unplugged"));
    assert!(received > 5);
    assert_eq!(cable.join().unwrap().unwrap(), 2000);
}

#[test]
fn nobody_listening_is_said_with_the_address() {
    // A port that was free a moment ago.
    let address = std::net::TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
    let error = Board::open(&PortSpec::Tcp(address.to_string())).map(|_| ()).unwrap_err();
    assert!(matches!(error, LinkError::NotListening { .. }), "{error}");
    assert!(error.to_string().contains(&address.to_string()));
}

#[test]
fn something_that_is_no_board_does_not_hang_the_tool() {
    let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let port = PortSpec::Tcp(listener.local_addr().unwrap().to_string());
    let server = spawn(move || {
        let (mut tool, _) = listener.accept().unwrap();
        let _ = std::io::Write::write_all(&mut tool, b"HTTP/1.1 400 Bad Request\r\n\r\n\0\0");
        let _ = std::io::copy(&mut tool, &mut std::io::sink());
    });
    let error = Board::open(&port).map(|_| ()).unwrap_err();
    assert!(matches!(error, LinkError::Silent { .. }), "{error}");
    server.join().unwrap();
}

/// A board of another protocol version: answers whatever it is asked with its `Info`.
struct OtherVersion {
    protocol: u16,
    out: Vec<u8>,
    asked: u32,
}

impl Wire for OtherVersion {
    fn send(&mut self, bytes: &[u8]) -> std::io::Result<()> {
        let mut requests = Vec::new();
        Deframer::default().feed(bytes, |frame| requests.push(frame));
        for request in requests {
            self.asked += 1;
            assert_eq!(self.asked, 1, "nothing more is asked of a board of another version");
            let info = Info {
                protocol: self.protocol,
                firmware: "9.9".chars().collect(),
                board: "odrive-v3".chars().collect(),
                serial: "A1".chars().collect(),
            };
            let header = VarHeader { key: VarKey::Key8(GetInfo::RESP_KEY), seq_no: request.header.seq_no };
            self.out.extend(encode(&header, &postcard::to_stdvec(&info).unwrap()));
        }
        Ok(())
    }
    fn receive(&mut self, buffer: &mut [u8], _: Duration) -> std::io::Result<usize> {
        let count = self.out.len().min(buffer.len());
        buffer[..count].copy_from_slice(&self.out[..count]);
        self.out.drain(..count);
        Ok(count)
    }
    fn now(&self) -> Duration {
        Duration::ZERO
    }
}

#[test]
fn a_board_of_another_protocol_version_is_named_and_left_alone() {
    for (protocol, remedy) in [(PROTOCOL + 1, "install the tool"), (PROTOCOL - 1, "flash the firmware")] {
        let wire = OtherVersion { protocol, out: Vec::new(), asked: 0 };
        let error = Board::over(Box::new(wire), "test").map(|_| ()).unwrap_err();
        assert!(matches!(error, LinkError::Version { board, tool: PROTOCOL } if board == protocol), "{error}");
        assert!(error.to_string().contains(remedy), "{error}");
    }
}

#[cfg(unix)]
mod pseudo_terminal {
    use super::*;
    use haptic::sim::door::pseudo_terminal;

    #[test]
    fn a_board_behind_a_pseudo_terminal_answers_and_streams_without_loss() {
        let served = Served::new(pseudo_terminal().unwrap(), Pace::AsFastAsItCan);
        let mut board = served.open().unwrap();
        let rows = stream(&mut board, 5_000);
        assert_eq!((board.losses().received, board.losses().missing), (rows as u64, 0));
        drop(board);
        assert_eq!(served.reopen().info().board.as_str(), "simulated");
    }

    #[test]
    fn a_port_in_use_is_said_to_be_in_use() {
        let served = Served::new(pseudo_terminal().unwrap(), Pace::RealTime);
        let _first = served.open().unwrap();
        let error = served.open().map(|_| ()).unwrap_err();
        assert!(matches!(error, LinkError::PortBusy(_)), "{error}");
    }

    #[test]
    fn a_port_that_does_not_exist_is_said_not_to() {
        let error = Board::open(&PortSpec::Serial("/dev/no-such-port".into())).map(|_| ()).unwrap_err();
        assert!(matches!(error, LinkError::NoSuchPort { .. }), "{error}");
        assert!(error.to_string().contains("/dev/no-such-port"));
    }
}

/// A board at 200 Hz that ends its server after half a second of its own time.
struct HalfASecond {
    board: SimulatedBoard,
    stop: Arc<AtomicBool>,
}

impl Hosted for HalfASecond {
    fn receive(&mut self, bytes: &[u8]) {
        self.board.receive(bytes);
    }
    fn take_bytes(&mut self, buffer: &mut [u8]) -> usize {
        self.board.take_bytes(buffer)
    }
    fn hang_up(&mut self) {
        self.board.hang_up();
    }
    fn run(&mut self, seconds: f64) {
        self.board.run(seconds);
    }
    fn time(&self) -> f64 {
        if self.board.time() > 0.5 {
            self.stop.store(true, Ordering::SeqCst);
        }
        self.board.time()
    }
}

#[test]
fn a_board_in_real_time_is_never_ahead_of_the_clock_however_long_its_periods_and_however_much_it_is_asked() {
    for asked in [false, true] {
        let door = tcp("127.0.0.1:0".parse().unwrap()).unwrap();
        let port: PortSpec = door.port.parse().unwrap();
        let stop = Arc::new(AtomicBool::new(false));
        let stopped = Arc::clone(&stop);
        let server = spawn(move || {
            let file = DeviceFile::parse(SHIPPED_DEVICE, "coupled-five-bar.toml").unwrap();
            let mut board = ready_board(&file, BoardOptions::default()).unwrap();
            let scene = Scene { task: 2, rate_hz: 200.0, cutoff_hz: 50.0, ..Scene::default() };
            board.load(&file.name, &file.description, Some(scene)).unwrap();
            let mut board = HalfASecond { board, stop: Arc::clone(&stopped) };
            let (began, before) = (Instant::now(), board.board.time());
            serve(&mut board, &door, Pace::RealTime, &stopped);
            (began.elapsed().as_secs_f64(), board.board.time() - before)
        });
        if asked {
            let mut board = Board::open(&port).unwrap();
            // Every request takes two control periods of the board's time.
            while board.status().is_ok() && !stop.load(Ordering::SeqCst) {}
        }
        let (clock, simulated) = server.join().unwrap();
        // What it is ahead by is what one slice or one request takes.
        assert!(simulated < clock + 0.021, "{simulated} s in {clock} s, asked: {asked}");
    }
}
