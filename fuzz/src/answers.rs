//! Fuzzes the tool's end of the link by a board that sends random bytes. Every call must end with a value or an error.

use haptic_bridge::board::protocol::{ENDPOINTS, GetInfo, Info, PROTOCOL, TOPICS_OUT};
use haptic_bridge::board::settings::Key;
use haptic_host::backup::Backup;
use haptic_host::link::{Board, Deframer, Wire, encode, fields};
use postcard_rpc::Endpoint as _;
use postcard_rpc::header::{VarHeader, VarKey, VarSeq};
use postcard_rpc::standard_icd::ERROR_KEY;
use std::collections::VecDeque;
use std::io;
use std::time::Duration;

/// Calls the functions of the link with a board that sends `data`, in pieces of an operation, a length and bytes.
pub fn answers(data: &[u8]) {
    let wire =
        RandomBoard { rest: data.to_vec().into(), requests: VecDeque::new(), deframer: Deframer::default(), clock: 0 };
    let Ok(mut board) = Board::over(Box::new(wire), "fuzz") else { return };
    let _ = board.details();
    let _ = board.status();
    let _ = board.device();
    let _ = board.scene();
    let _ = board.rules();
    let _ = board.faults();
    let _ = board.read_entry(Key::Rules);
    let _ = board.arm();
    board.keep_alive();
    let _ = board.start_stream(fields("all").expect("a set of fields"), 1);
    for _ in 0..20 {
        if board.rows(Duration::from_millis(50)).is_err() {
            break;
        }
    }
    let _ = board.stop_stream();
    assert!(!board.losses().to_string().is_empty());
    if let Ok(backup) = Backup::read(&mut board) {
        let _ = backup.prepared_settings();
    }
}

/// A wire to a board that sends pieces of the input.
struct RandomBoard {
    rest: VecDeque<u8>,
    /// Headers of the requests that have no reply yet.
    requests: VecDeque<VarHeader>,
    deframer: Deframer,
    clock: u64,
}

impl RandomBoard {
    /// Returns the next piece as bytes on the wire.
    fn next_piece(&mut self) -> Option<Vec<u8>> {
        let operation = self.rest.pop_front()?;
        let length = usize::from(self.rest.pop_front().unwrap_or(0)) * if operation & 0x80 == 0 { 1 } else { 4 };
        let body: Vec<u8> = self.rest.drain(..length.min(self.rest.len())).collect();
        let request = self.requests.pop_front();
        Some(match operation & 0x7F {
            // Replies to the oldest request.
            0..=63 => match request {
                Some(VarHeader { key, seq_no }) => {
                    let endpoint = ENDPOINTS.endpoints.iter().find(|(_, request, _)| VarKey::Key8(*request) == key);
                    let key = VarKey::Key8(endpoint.map_or(ERROR_KEY, |(_, _, reply)| *reply));
                    encode(&VarHeader { key, seq_no }, &body)
                }
                None => body,
            },
            64..=71 => {
                let seq_no = request.map_or(VarSeq::Seq2(0), |request| request.seq_no);
                encode(&VarHeader { key: VarKey::Key8(ERROR_KEY), seq_no }, &body)
            }
            72..=111 => {
                let (_, key) = TOPICS_OUT.topics[usize::from(operation) % TOPICS_OUT.topics.len()];
                encode(&VarHeader { key: VarKey::Key8(key), seq_no: VarSeq::Seq2(0) }, &body)
            }
            _ => body,
        })
    }
}

impl Wire for RandomBoard {
    fn send(&mut self, bytes: &[u8]) -> io::Result<()> {
        let requests = &mut self.requests;
        self.deframer.feed(bytes, |frame| requests.push_back(frame.header));
        Ok(())
    }

    fn receive(&mut self, buffer: &mut [u8], timeout: Duration) -> io::Result<usize> {
        self.clock += timeout.as_micros() as u64 + 1;
        // Sends a valid reply to the first request for half of the inputs, because the fuzzer could hardly guess it.
        let first = self.requests.front().filter(|request| request.key == VarKey::Key8(GetInfo::REQ_KEY));
        let bytes = match first.filter(|_| self.rest.front().is_some_and(|byte| byte & 1 == 0)) {
            Some(request) => {
                let header = VarHeader { key: VarKey::Key8(GetInfo::RESP_KEY), seq_no: request.seq_no };
                self.requests.pop_front();
                self.rest.pop_front();
                let info = Info {
                    protocol: PROTOCOL,
                    firmware: "1".chars().collect(),
                    board: "fuzz".chars().collect(),
                    serial: "F".chars().collect(),
                };
                encode(&header, &postcard::to_stdvec(&info).unwrap_or_default())
            }
            None => self.next_piece().ok_or(io::ErrorKind::UnexpectedEof)?,
        };
        let count = bytes.len().min(buffer.len());
        buffer[..count].copy_from_slice(&bytes[..count]);
        Ok(count)
    }

    fn now(&self) -> Duration {
        Duration::from_micros(self.clock)
    }
}
