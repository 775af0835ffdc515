//! Requests and their answers, and the topic messages that come between them.

use super::error::LinkError;
use super::framing::{Deframer, Packet};
use super::wire::Wire;
use haptic_bridge::board::framing::{encode, most_on_wire};
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
    /// The sender's count of messages, as wide as it sends it.
    pub sequence: VarSeq,
    body: Vec<u8>,
}

impl TopicFrame {
    /// The message, when it is one of topic `T`; `None` when it is of another.
    pub fn message<T: Topic>(&self) -> Option<Result<T::Message, LinkError>>
    where
        T::Message: DeserializeOwned,
    {
        (self.key == VarKey::Key8(T::TOPIC_KEY)).then(|| whole(&self.body, T::PATH))
    }
}

/// A connection that speaks frames.
pub struct Client {
    wire: Box<dyn Wire>,
    deframer: Deframer,
    /// Requests that were sent, and neither answered nor given up: their number, and the key of their answer.
    under_way: VecDeque<(VarSeq, VarKey)>,
    answers: VecDeque<Packet>,
    topics: VecDeque<TopicFrame>,
    sequence: u16,
    buffer: Vec<u8>,
    /// True if heartbeats go out while an answer is waited for.
    pub(super) alive: bool,
    /// Times that the last request of [`Client::call`] was sent again: it may have been carried out before.
    pub(super) repeats: u32,
    /// Bodies of answers that were read: their memory is used again, so that an exchange of forces allocates none.
    spare: Vec<Vec<u8>>,
}

/// Time after which a request that was not answered is sent again, and after which it is given up.
pub type Patience = (Duration, Duration);
/// Interval at which the host sends heartbeats, where it was asked to.
pub(super) const HEARTBEAT: Duration = Duration::from_millis(50);
/// Times that a request is sent again whose answer rejects it or cannot be read: fewer may be spoilt frames.
const UNREADABLE: u32 = 3;

/// A message that takes all of these bytes: what is longer was spoilt on its way.
fn whole<M: DeserializeOwned>(body: &[u8], path: &'static str) -> Result<M, LinkError> {
    match postcard::take_from_bytes(body) {
        Ok((message, [])) => Ok(message),
        _ => Err(LinkError::Unreadable { what: path }),
    }
}

/// Length of the longest encoded frame, bytes.
const MAX_ENCODED: usize = most_on_wire(MAX_FRAME);

/// Largest number of requests under way: the oldest beyond that are given up.
const MOST_UNDER_WAY: usize = 8;

/// A request on its way.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sent(VarSeq);

/// The answer to a request to disarm once the motors are off, whatever the protocol's version: its key is of that
/// version's refusals, its body this.
const STOPPED: &[u8] = &[0];

/// The message that the server of a simulated board sends a second tool before it hangs up.
pub struct Occupied;

impl Topic for Occupied {
    type Message = ();
    const PATH: &'static str = "haptic/occupied";
    const TOPIC_KEY: Key = Key::for_path::<()>(Self::PATH);
}

impl Client {
    /// A client on an open wire.
    pub fn new(mut wire: Box<dyn Wire>) -> Self {
        Self {
            // An answer to an earlier tool must not pass for an answer to this one.
            sequence: wire.draw() as u16,
            wire,
            deframer: Deframer::default(),
            under_way: VecDeque::new(),
            answers: VecDeque::new(),
            topics: VecDeque::new(),
            buffer: vec![0; 16 * 1024],
            alive: false,
            repeats: 0,
            spare: Vec::new(),
        }
    }

    /// The wire's clock.
    pub fn now(&self) -> Duration {
        self.wire.now()
    }

    /// Extra time that an answer may take beyond the board's own, see [`Wire::slack`].
    pub fn slack(&self) -> Duration {
        self.wire.slack()
    }

    /// A number that is most likely not the one drawn last, see [`Wire::draw`].
    pub fn draw(&mut self) -> u32 {
        self.wire.draw()
    }

    /// Stretches of bytes that were not frames.
    pub fn garbled(&self) -> u64 {
        self.deframer.garbled
    }

    /// Ends whatever frame a tool before this one left unfinished.
    pub fn end_frame(&mut self) -> Result<(), LinkError> {
        self.wire.send(&[0]).map_err(LinkError::Lost)
    }

    /// Returns true if the other side has said that another tool is connected.
    pub fn was_told_occupied(&self) -> bool {
        self.topics.iter().any(|topic| topic.key == VarKey::Key8(Occupied::TOPIC_KEY))
    }

    /// Sends a request of endpoint `E` and waits for its answer. A spoilt frame costs little: the request is sent again,
    /// under its number, after the first of the two times or half of what was waited, whichever is longer. Topic messages
    /// that come meanwhile are kept.
    pub fn call<E: Endpoint>(&mut self, request: &E::Request, patience: Patience) -> Result<E::Response, LinkError>
    where
        E::Request: Serialize,
        E::Response: DeserializeOwned,
    {
        let (sent, frame, length) = self.send_frame::<E>(request)?;
        let (again, began) = (patience.0, self.now());
        let (mut asked, end) = (began, began + patience.1);
        self.repeats = 0;
        let answer = loop {
            let before = self.now();
            let due = end.min(asked + again.max((before - began) / 2));
            match self.read::<E>(sent, due.saturating_sub(before).min(HEARTBEAT)) {
                Err(LinkError::Rejected { .. } | LinkError::Unreadable { .. }) if self.repeats < UNREADABLE => {}
                Err(LinkError::Silent { .. }) if self.now() < end => {
                    if self.alive {
                        let beat = self.send::<Heartbeat>(&Beat::Here)?;
                        self.forget(beat);
                    }
                    if self.now() < due {
                        continue;
                    }
                }
                answer => break answer,
            }
            // The board may hold a part of the last one.
            self.wire.send(&[&[0], &frame[..length]].concat()).map_err(LinkError::Lost)?;
            (self.repeats, asked) = (self.repeats + 1, self.now());
        };
        self.forget(sent);
        answer
    }

    /// Sends a request of endpoint `E`; what [`Client::answer`] wants to know of it.
    pub fn send<E: Endpoint>(&mut self, request: &E::Request) -> Result<Sent, LinkError>
    where
        E::Request: Serialize,
    {
        self.send_frame::<E>(request).map(|(sent, ..)| sent)
    }

    /// Sends a request. Returns its number, the encoded frame and the frame's length, without allocating.
    fn send_frame<E: Endpoint<Request: Serialize>>(
        &mut self,
        request: &E::Request,
    ) -> Result<(Sent, [u8; MAX_ENCODED], usize), LinkError> {
        self.sequence = self.sequence.wrapping_add(1);
        let sent = Sent(VarSeq::Seq2(self.sequence));
        let key = VarKey::Key8(E::REQ_KEY);
        let mut frame = [0; MAX_ENCODED];
        let write = |frame: &mut [u8]| {
            let (head, rest) = VarHeader { key, seq_no: sent.0 }.write_to_slice(frame.get_mut(1..)?)?;
            let length = head.len() + postcard::to_slice(request, rest).ok()?.len();
            encode(frame, length)
        };
        let count = write(&mut frame).ok_or(LinkError::Unreadable { what: E::PATH })?;
        self.wire.send(&frame[..count]).map_err(LinkError::Lost)?;
        self.under_way.push_back((sent.0, VarKey::Key8(E::RESP_KEY)));
        if self.under_way.len() > MOST_UNDER_WAY {
            let given_up = self.under_way.pop_front();
            self.answers.retain(|frame| given_up.is_none_or(|(number, _)| frame.header.seq_no != number));
        }
        Ok((sent, frame, count))
    }

    /// Waits for the answer to a request of endpoint `E`. Requests are answered in their order: where one that was sent
    /// after it is answered, its own answer was lost. Answers to others that are under way are kept.
    pub fn answer<E: Endpoint>(&mut self, sent: Sent, timeout: Duration) -> Result<E::Response, LinkError>
    where
        E::Response: DeserializeOwned,
    {
        let answer = self.read::<E>(sent, timeout);
        self.forget(sent);
        answer
    }

    fn forget(&mut self, sent: Sent) {
        self.under_way.retain(|(number, _)| *number != sent.0);
        self.answers.retain(|frame| frame.header.seq_no != sent.0);
    }

    fn read<E: Endpoint<Response: DeserializeOwned>>(
        &mut self,
        sent: Sent,
        timeout: Duration,
    ) -> Result<E::Response, LinkError> {
        let Packet { header, body } = self.answered(sent, E::PATH, timeout)?;
        let stopped = E::REQ_KEY == Disarm::REQ_KEY && body == STOPPED;
        let reply = if header.key == VarKey::Key8(E::RESP_KEY) || stopped {
            whole(&body, E::PATH)
        } else {
            whole::<WireError>(&body, E::PATH)
                .and_then(|error| Err(LinkError::Rejected { what: E::PATH, error: error.to_string() }))
        };
        if self.spare.len() < MOST_UNDER_WAY {
            self.spare.push(body);
        }
        reply
    }

    /// Returns the index of a request among those that are under way.
    fn place(&self, number: VarSeq) -> Option<usize> {
        self.under_way.iter().position(|(other, _)| *other == number)
    }

    /// The answer to a request, or the error in its place.
    fn answered(&mut self, sent: Sent, path: &'static str, timeout: Duration) -> Result<Packet, LinkError> {
        let deadline = self.wire.now() + timeout;
        loop {
            let own = self.answers.iter().position(|frame| frame.header.seq_no == sent.0);
            if let Some(frame) = own.and_then(|at| self.answers.remove(at)) {
                return Ok(frame);
            }
            if self.answers.iter().any(|frame| self.place(frame.header.seq_no) > self.place(sent.0)) {
                return Err(LinkError::Silent { what: path });
            }
            let left = deadline.saturating_sub(self.wire.now());
            if left.is_zero() {
                return Err(LinkError::Silent { what: path });
            }
            self.pump(left)?;
        }
    }

    /// The next topic message, waiting at most `timeout` for it.
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

    /// Takes in what the wire has; answers to what is under way wait for [`Self::answer`], the others are topics,
    /// except the answers to heartbeats that went out beside a request.
    fn pump(&mut self, timeout: Duration) -> Result<(), LinkError> {
        let count = self.wire.receive(&mut self.buffer, timeout).map_err(LinkError::Lost)?;
        let (under_way, waiting, topics) = (&self.under_way, &mut self.answers, &mut self.topics);
        let (spare, mut headless) = (&mut self.spare, 0);
        self.deframer.feed_plain(&self.buffer[..count], |plain| {
            let Some((header, read)) = VarHeader::take_from_slice(plain) else {
                headless += 1;
                return;
            };
            let VarHeader { key, seq_no } = header;
            let stopped = |to: VarKey| to == VarKey::Key8(Disarm::RESP_KEY) && read == STOPPED;
            let answers = |to: &(VarSeq, VarKey)| {
                to.0 == seq_no && (to.1 == key || key == VarKey::Key8(ERROR_KEY) || stopped(to.1))
            };
            if under_way.iter().any(answers) {
                let mut body = spare.pop().unwrap_or_default();
                body.clear();
                body.extend_from_slice(read);
                waiting.push_back(Packet { header, body });
            } else if key != VarKey::Key8(Heartbeat::RESP_KEY) {
                topics.push_back(TopicFrame { key, sequence: seq_no, body: read.to_vec() });
            }
        });
        self.deframer.garbled += headless;
        Ok(())
    }
}
