//! Requests with their replies, and topic messages, which may come at any time.

use super::error::LinkError;
use super::framing::{Deframer, Packet};
use super::wire::Wire;
use haptic_bridge::board::framing::{encode, max_wire_length};
use haptic_bridge::board::protocol::{Beat, Disarm, Heartbeat, MAX_FRAME};
use postcard_rpc::header::{VarHeader, VarKey, VarSeq};
use postcard_rpc::standard_icd::{ERROR_KEY, WireError};
use postcard_rpc::{Endpoint, Key, Topic};
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::collections::VecDeque;
use std::time::Duration;

/// A topic message as it arrived.
#[derive(Clone, Debug, PartialEq)]
pub struct TopicFrame {
    key: VarKey,
    /// The sender's message counter, in the width that the sender uses.
    pub sequence: VarSeq,
    body: Vec<u8>,
}

impl TopicFrame {
    /// Decodes the message if it belongs to topic `T`, otherwise returns `None`.
    pub fn message<T: Topic>(&self) -> Option<Result<T::Message, LinkError>>
    where
        T::Message: DeserializeOwned,
    {
        (self.key == VarKey::Key8(T::TOPIC_KEY)).then(|| decode_all(&self.body, T::PATH))
    }
}

/// A connection that exchanges frames.
pub struct Client {
    wire: Box<dyn Wire>,
    deframer: Deframer,
    /// Sequence numbers and reply keys of the pending requests.
    pending_requests: VecDeque<(VarSeq, VarKey)>,
    replies: VecDeque<Packet>,
    topics: VecDeque<TopicFrame>,
    sequence: u16,
    buffer: Vec<u8>,
    /// True if the client sends heartbeats while it waits for a reply.
    pub(super) sends_heartbeats: bool,
    /// Number of retries in the last [`Client::call`]. The board may have carried out an earlier copy of the request.
    pub(super) repeats: u32,
    /// Buffers of earlier replies, reused so that an exchange of forces allocates no memory.
    spare_buffers: Vec<Vec<u8>>,
}

/// Retry interval of a request, and longest wait for its reply.
pub type Patience = (Duration, Duration);
/// Interval between heartbeats, if they are enabled.
pub(super) const HEARTBEAT_INTERVAL: Duration = Duration::from_millis(50);
/// Maximum number of retries after rejected or unreadable replies, which corrupted frames may cause.
const MAX_UNREADABLE_REPLIES: u32 = 3;

/// Decodes a message from all of `body`. Rejects a body with further bytes, because it was corrupted.
fn decode_all<M: DeserializeOwned>(body: &[u8], path: &'static str) -> Result<M, LinkError> {
    match postcard::take_from_bytes(body) {
        Ok((message, [])) => Ok(message),
        _ => Err(LinkError::Unreadable { what: path }),
    }
}

/// Length of the longest encoded frame, bytes.
const MAX_ENCODED_BYTES: usize = max_wire_length(MAX_FRAME);

/// Maximum number of pending requests. A further request replaces the oldest.
const MAX_PENDING_REQUESTS: usize = 8;

/// Handle of a request that was sent, for [`Client::reply`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SentRequest(VarSeq);

/// Body of the reply to a carried-out disarm request, in every version of the protocol. The key of the reply depends on
/// the version.
const DISARMED_BODY: &[u8] = &[0];

/// The message with which the server of a simulated board refuses a second tool.
pub struct OccupiedTopic;

impl Topic for OccupiedTopic {
    type Message = ();
    const PATH: &'static str = "haptic/occupied";
    const TOPIC_KEY: Key = Key::for_path::<()>(Self::PATH);
}

impl Client {
    /// Creates a client on an open wire.
    pub fn new(mut wire: Box<dyn Wire>) -> Self {
        Self {
            // Starts at a random number, so that replies to an earlier tool do not match.
            sequence: wire.draw() as u16,
            wire,
            deframer: Deframer::default(),
            pending_requests: VecDeque::new(),
            replies: VecDeque::new(),
            topics: VecDeque::new(),
            buffer: vec![0; 16 * 1024],
            sends_heartbeats: false,
            repeats: 0,
            spare_buffers: Vec::new(),
        }
    }

    /// Returns the time of the wire's clock.
    pub fn now(&self) -> Duration {
        self.wire.now()
    }
    /// Returns the extra time that a reply may take, see [`Wire::slack`].
    pub fn slack(&self) -> Duration {
        self.wire.slack()
    }
    /// Draws a random number, see [`Wire::draw`].
    pub fn draw(&mut self) -> u32 {
        self.wire.draw()
    }
    /// Returns the number of byte sequences between delimiters that were not valid frames.
    pub fn garbled_sequences(&self) -> u64 {
        self.deframer.garbled
    }
    /// Sends a delimiter, which ends a partial frame that an earlier tool may have sent.
    pub fn end_frame(&mut self) -> Result<(), LinkError> {
        self.wire.send(&[0]).map_err(LinkError::Lost)
    }
    /// Returns true if the server has reported that another tool is connected.
    pub fn is_occupied(&self) -> bool {
        self.topics.iter().any(|topic| topic.key == VarKey::Key8(OccupiedTopic::TOPIC_KEY))
    }
    /// Sends a request of endpoint `E` and waits for its reply. Because frames may be corrupted, sends the request
    /// again with the same number after the retry interval or half of the time waited, whichever is longer. Keeps the
    /// topic messages that come meanwhile.
    pub fn call<E: Endpoint>(&mut self, request: &E::Request, patience: Patience) -> Result<E::Response, LinkError>
    where
        E::Request: Serialize,
        E::Response: DeserializeOwned,
    {
        let (sent, frame, length) = self.send_frame::<E>(request)?;
        let (retry_interval, began) = (patience.0, self.now());
        let (mut last_sent, end) = (began, began + patience.1);
        self.repeats = 0;
        let reply = loop {
            let before = self.now();
            let due = end.min(last_sent + retry_interval.max((before - began) / 2));
            match self.read::<E>(sent, due.saturating_sub(before).min(HEARTBEAT_INTERVAL)) {
                Err(LinkError::Rejected { .. } | LinkError::Unreadable { .. })
                    if self.repeats < MAX_UNREADABLE_REPLIES => {}
                Err(LinkError::Silent { .. }) if self.now() < end => {
                    if self.sends_heartbeats {
                        let beat = self.send::<Heartbeat>(&Beat::Here)?;
                        self.forget(beat);
                    }
                    if self.now() < due {
                        continue;
                    }
                }
                reply => break reply,
            }
            // Begins with a delimiter, which ends a partial frame in the board's buffer.
            self.wire.send(&[&[0], &frame[..length]].concat()).map_err(LinkError::Lost)?;
            (self.repeats, last_sent) = (self.repeats + 1, self.now());
        };
        self.forget(sent);
        reply
    }

    /// Sends a request of endpoint `E`. Returns its handle for [`Client::reply`].
    pub fn send<E: Endpoint>(&mut self, request: &E::Request) -> Result<SentRequest, LinkError>
    where
        E::Request: Serialize,
    {
        self.send_frame::<E>(request).map(|(sent, ..)| sent)
    }

    /// Sends a request. Returns its number, the encoded frame and the frame's length, without allocating.
    fn send_frame<E: Endpoint<Request: Serialize>>(
        &mut self,
        request: &E::Request,
    ) -> Result<(SentRequest, [u8; MAX_ENCODED_BYTES], usize), LinkError> {
        self.sequence = self.sequence.wrapping_add(1);
        let sent = SentRequest(VarSeq::Seq2(self.sequence));
        let key = VarKey::Key8(E::REQ_KEY);
        let mut frame = [0; MAX_ENCODED_BYTES];
        let write = |frame: &mut [u8]| {
            let (head, rest) = VarHeader { key, seq_no: sent.0 }.write_to_slice(frame.get_mut(1..)?)?;
            let length = head.len() + postcard::to_slice(request, rest).ok()?.len();
            encode(frame, length)
        };
        let count = write(&mut frame).ok_or(LinkError::Unreadable { what: E::PATH })?;
        self.wire.send(&frame[..count]).map_err(LinkError::Lost)?;
        self.pending_requests.push_back((sent.0, VarKey::Key8(E::RESP_KEY)));
        if self.pending_requests.len() > MAX_PENDING_REQUESTS {
            let given_up = self.pending_requests.pop_front();
            self.replies.retain(|frame| given_up.is_none_or(|(number, _)| frame.header.seq_no != number));
        }
        Ok((sent, frame, count))
    }

    /// Waits for the reply to a request of endpoint `E`. Returns an error if the reply to a later request has come,
    /// because replies come in the order of the requests. Keeps the replies to other pending requests.
    pub fn reply<E: Endpoint>(&mut self, sent: SentRequest, timeout: Duration) -> Result<E::Response, LinkError>
    where
        E::Response: DeserializeOwned,
    {
        let reply = self.read::<E>(sent, timeout);
        self.forget(sent);
        reply
    }

    fn forget(&mut self, sent: SentRequest) {
        self.pending_requests.retain(|(number, _)| *number != sent.0);
        self.replies.retain(|frame| frame.header.seq_no != sent.0);
    }
    fn read<E: Endpoint<Response: DeserializeOwned>>(
        &mut self,
        sent: SentRequest,
        timeout: Duration,
    ) -> Result<E::Response, LinkError> {
        let Packet { header, body } = self.wait_for_reply(sent, E::PATH, timeout)?;
        let stopped = E::REQ_KEY == Disarm::REQ_KEY && body == DISARMED_BODY;
        let reply = if header.key == VarKey::Key8(E::RESP_KEY) || stopped {
            decode_all(&body, E::PATH)
        } else {
            decode_all::<WireError>(&body, E::PATH)
                .and_then(|error| Err(LinkError::Rejected { what: E::PATH, error: error.to_string() }))
        };
        if self.spare_buffers.len() < MAX_PENDING_REQUESTS {
            self.spare_buffers.push(body);
        }
        reply
    }

    fn index_of(&self, number: VarSeq) -> Option<usize> {
        self.pending_requests.iter().position(|(other, _)| *other == number)
    }
    /// Waits for the reply to a request, or the error in its place.
    fn wait_for_reply(
        &mut self,
        sent: SentRequest,
        path: &'static str,
        timeout: Duration,
    ) -> Result<Packet, LinkError> {
        let deadline = self.wire.now() + timeout;
        loop {
            let own = self.replies.iter().position(|frame| frame.header.seq_no == sent.0);
            if let Some(frame) = own.and_then(|at| self.replies.remove(at)) {
                return Ok(frame);
            }
            if self.replies.iter().any(|frame| self.index_of(frame.header.seq_no) > self.index_of(sent.0)) {
                return Err(LinkError::Silent { what: path });
            }
            let left = deadline.saturating_sub(self.wire.now());
            if left.is_zero() {
                return Err(LinkError::Silent { what: path });
            }
            self.pump(left)?;
        }
    }

    /// Returns the next topic message; waits at most `timeout` for it.
    pub fn topic(&mut self, timeout: Duration) -> Result<Option<TopicFrame>, LinkError> {
        let deadline = self.wire.now() + timeout;
        loop {
            if let Some(frame) = self.topics.pop_front() {
                return Ok(Some(frame));
            }
            let left = deadline.saturating_sub(self.wire.now());
            if left.is_zero() {
                return Ok(None);
            }
            self.pump(left)?;
        }
    }

    /// Receives bytes from the wire. Stores replies to pending requests for [`Self::reply`], and all other messages as
    /// topics, except replies to heartbeats that were sent during a request.
    fn pump(&mut self, timeout: Duration) -> Result<(), LinkError> {
        let count = self.wire.receive(&mut self.buffer, timeout).map_err(LinkError::Lost)?;
        let (pending, waiting, topics) = (&self.pending_requests, &mut self.replies, &mut self.topics);
        let (spare, mut headless) = (&mut self.spare_buffers, 0);
        self.deframer.feed_plain(&self.buffer[..count], |plain| {
            let Some((header, remaining)) = VarHeader::take_from_slice(plain) else {
                headless += 1;
                return;
            };
            let VarHeader { key, seq_no } = header;
            let stopped = |to: VarKey| to == VarKey::Key8(Disarm::RESP_KEY) && remaining == DISARMED_BODY;
            let is_reply = |to: &(VarSeq, VarKey)| {
                to.0 == seq_no && (to.1 == key || key == VarKey::Key8(ERROR_KEY) || stopped(to.1))
            };
            if pending.iter().any(is_reply) {
                let mut body = spare.pop().unwrap_or_default();
                body.clear();
                body.extend_from_slice(remaining);
                waiting.push_back(Packet { header, body });
            } else if key != VarKey::Key8(Heartbeat::RESP_KEY) {
                topics.push_back(TopicFrame { key, sequence: seq_no, body: remaining.to_vec() });
            }
        });
        self.deframer.garbled += headless;
        Ok(())
    }
}
