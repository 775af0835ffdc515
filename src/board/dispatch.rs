//! Turns a request frame into a reply frame: decodes the request, calls the [`Service`], encodes the reply. Identical
//! on real, simulated and emulated boards.
//!
//! A frame is a postcard-rpc header (key, sequence number) and a postcard body. The reply to an invalid request is
//! postcard-rpc's error message. An invalid frame has no other effect.

use crate::board::machine::{Machine, Measurements};
use crate::board::protocol::*;
use crate::board::service::Service;
use crate::board::telemetry::{Batch, Field, RowShape, StreamRequest};
use crate::control::Command;
use postcard_rpc::header::{VarHeader, VarKey, VarSeq};
use postcard_rpc::standard_icd::{ERROR_KEY, WireError};
use postcard_rpc::{Endpoint, Topic};
use serde::{Serialize, de::DeserializeOwned};

/// A [`Machine`] that can describe itself to a tool.
pub trait Described: Machine {
    /// Returns the board's identity.
    fn info(&self) -> Info;
    /// Returns measurements of the machine.
    fn measurements(&mut self) -> Measurements;
}

/// Work for the caller after the reply has been sent.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum AfterReply {
    /// No work.
    Nothing,
    /// Start, change or stop the telemetry stream, with rows of this shape.
    Stream(StreamRequest, RowShape),
    /// Enter the boot loader.
    BootLoader,
    /// Restart.
    Restart,
}

/// Carries out the request in `frame` (without COBS), and writes the reply frame to `out` (at least [`MAX_FRAME`]
/// bytes). Returns the reply, or `None` if `frame` is not a frame, and the remaining work for the caller.
pub fn answer<'o, M: Described>(
    service: &mut Service,
    machine: &mut M,
    frame: &[u8],
    out: &'o mut [u8],
) -> (Option<&'o [u8]>, AfterReply) {
    let Some((header, body)) = VarHeader::take_from_slice(frame) else { return (None, AfterReply::Nothing) };
    let mut after = AfterReply::Nothing;
    let length = route(service, machine, &Request { header, body }, out, &mut after);
    (length.and_then(|length| out.get(..length)), after)
}

/// Writes a topic message as a frame (without COBS) to `out`. Returns `None` if the frame does not fit.
pub fn publish<'o, T: Topic>(sequence: u16, message: &T::Message, out: &'o mut [u8]) -> Option<&'o [u8]>
where
    T::Message: Serialize + Sized,
{
    let header = VarHeader { key: VarKey::Key8(T::TOPIC_KEY), seq_no: VarSeq::Seq2(sequence) };
    let length = encode(&header, message, out)?;
    out.get(..length)
}

/// Writes a batch of telemetry as a frame. Compiled here, because this crate is optimized for speed.
#[inline(never)]
pub fn telemetry<'o>(sequence: u16, batch: &Batch, out: &'o mut [u8]) -> Option<&'o [u8]> {
    publish::<Telemetry>(sequence, batch, out)
}

struct Request<'f> {
    header: VarHeader,
    body: &'f [u8],
}

impl Request<'_> {
    fn is_for<E: Endpoint>(&self) -> bool {
        self.header.key == VarKey::Key8(E::REQ_KEY)
    }

    /// Decodes the request, does the work and encodes the reply. Never inlined, because each endpoint then has its own
    /// stack frame, and the largest messages are not on the stack together.
    #[inline(never)]
    fn serve<E: Endpoint>(&self, out: &mut [u8], work: impl FnOnce(E::Request) -> E::Response) -> Option<usize>
    where
        E::Request: DeserializeOwned,
        E::Response: Serialize,
    {
        match postcard::take_from_bytes(self.body) {
            Ok((request, [])) => {
                let header = VarHeader { key: VarKey::Key8(E::RESP_KEY), seq_no: self.header.seq_no };
                encode(&header, &work(request), out).or_else(|| self.fail(WireError::SerFailed, out))
            }
            _ => self.fail(WireError::DeserFailed, out),
        }
    }

    /// Runs [`Request::serve`] for a host's force requests, which arrive thousands of times per second.
    fn serve_force(&self, out: &mut [u8], work: impl FnOnce(&ForceRequest) -> ForceAnswer) -> Option<usize> {
        let Some(request) = &read_force(self.body) else { return self.fail(WireError::DeserFailed, out) };
        let header = VarHeader { key: VarKey::Key8(Force::RESP_KEY), seq_no: self.header.seq_no };
        write_force(&header, &work(request), out)
    }

    fn fail(&self, error: WireError, out: &mut [u8]) -> Option<usize> {
        encode(&VarHeader { key: VarKey::Key8(ERROR_KEY), seq_no: self.header.seq_no }, &error, out)
    }
}

// Generic code is compiled in the crate that uses it, and the firmware is optimized for size. These functions are
// compiled for speed.

#[inline(never)]
fn read_force(body: &[u8]) -> Option<ForceRequest> {
    match postcard::take_from_bytes(body) {
        Ok((request, [])) => Some(request),
        _ => None,
    }
}

#[inline(never)]
fn write_force(header: &VarHeader, answer: &ForceAnswer, out: &mut [u8]) -> Option<usize> {
    encode(header, answer, out)
}

fn encode(header: &VarHeader, message: &impl Serialize, out: &mut [u8]) -> Option<usize> {
    let (head, rest) = header.write_to_slice(out)?;
    let head = head.len();
    let body = postcard::to_slice(message, rest).ok()?.len();
    Some(head + body)
}

/// Runs the arm of the request's endpoint and replies. Continues if no arm matches.
macro_rules! serve {
    ($request:ident, $out:ident; $($Endpoint:ident: |$message:pat_param| $work:expr;)*) => {
        $(if $request.is_for::<$Endpoint>() {
            return $request.serve::<$Endpoint>($out, |$message| $work);
        })*
    };
}

fn route<M: Described>(
    service: &mut Service,
    machine: &mut M,
    request: &Request,
    out: &mut [u8],
    after: &mut AfterReply,
) -> Option<usize> {
    // Short keys collide, so a tool that uses short keys receives an error.
    if matches!(request.header.key, VarKey::Key1(_) | VarKey::Key2(_)) {
        return request.fail(WireError::KeyTooSmall, out);
    }
    if request.is_for::<Force>() {
        return request.serve_force(out, |force| machine.force(force));
    }
    serve! { request, out;
        GetStatus: |()| machine.status();
        Heartbeat: |beat| service.heartbeat(machine, beat);
        Arm: |()| service.arm(machine, None);
        ArmHeld: |press| service.arm(machine, Some(press));
        Disarm: |()| service.disarm(machine);
        SetGains: |gains| service.set_gains(machine, &gains);
        SetScene: |scene| service.set_scene(machine, scene);
        SetDevice: |device| service.set_device(machine, device);
        GetInfo: |()| machine.info();
        GetDetails: |()| service.details(machine.measurements());
        GetDevice: |()| service.device().cloned();
        GetScene: |()| service.scene().cloned();
        SetRules: |rules| service.set_rules(machine, rules);
        GetRules: |()| *service.rules();
        Home: |()| service.home(machine);
        CheckPolarity: |()| service.check_polarity(machine);
        FindStops: |press| service.find_stops(machine, press);
        SetCogging: |cogging| service.set_cogging(machine, cogging);
        GetCogging: |()| service.cogging().clone();
        Clear: |()| service.clear(machine);
        GetFaults: |()| service.faults().clone();
        Stream: |stream| {
            let energy = stream.divider > 0 && stream.fields.0 & Field::Energy.bit() != 0;
            machine.execute(Command::ShowEnergy(energy)).0?;
            *after = AfterReply::Stream(stream, RowShape::of(service.device()));
            Ok(())
        };
        Save: |()| service.save(machine);
        ReadEntry: |key| service.read_entry(machine, key);
        StageEntry: |entry| service.stage_entry(machine, &entry);
        CommitEntries: |commit| service.commit_entries(machine, &commit);
        SetName: |name| {
            service.set_name(name);
            Ok(())
        };
        EnterDfu: |()| {
            *after = AfterReply::BootLoader;
            service.disarm(machine)
        };
        Restart: |()| {
            *after = AfterReply::Restart;
            service.disarm(machine)
        };
    }
    request.fail(WireError::UnknownKey, out)
}

#[cfg(test)]
mod tests {
    use super::{ERROR_KEY, Request, VarHeader, VarKey, VarSeq, WireError};
    use postcard_rpc::{Endpoint, endpoints};

    endpoints! {
        list = TOYS;
        | EndpointTy | RequestTy | ResponseTy | Path         |
        | ---------- | --------- | ---------- | ----         |
        | Double     | u32       | u32        | "toy/double" |
        | Unserved   | u32       | u32        | "toy/none"   |
    }

    fn route(request: &Request, out: &mut [u8]) -> Option<usize> {
        serve! { request, out;
            Double: |number| 2 * number;
        }
        request.fail(WireError::UnknownKey, out)
    }

    /// Sends a number to an endpoint. Returns the key of the reply and its number, if any.
    fn reply_to<E: Endpoint>(number: u32) -> (VarKey, Option<u32>) {
        let (mut body, mut out) = ([0; 8], [0; 64]);
        let body = postcard::to_slice(&number, &mut body).unwrap();
        let header = VarHeader { key: VarKey::Key8(E::REQ_KEY), seq_no: VarSeq::Seq2(5) };
        let length = route(&Request { header, body }, &mut out).unwrap();
        let (header, body) = VarHeader::take_from_slice(&out[..length]).unwrap();
        assert_eq!(header.seq_no, VarSeq::Seq2(5));
        (header.key, postcard::from_bytes(body).ok())
    }

    #[test]
    fn an_endpoint_needs_one_line_and_one_arm() {
        assert!(TOYS.endpoints.iter().any(|(path, ..)| *path == "toy/double"));
        assert_eq!(reply_to::<Double>(21), (VarKey::Key8(Double::RESP_KEY), Some(42)));
        assert_eq!(reply_to::<Unserved>(21).0, VarKey::Key8(ERROR_KEY));
    }
}
