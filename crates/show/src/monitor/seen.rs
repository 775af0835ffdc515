//! Everything that the terminal has heard of the board.

use crate::outline::Outline;
use crate::view::message::{FromPage, ScopeRequest};
use crate::view::stability::Plane;
use haptic_bridge::render::scene::FeedForward;
use serde_json::Value;

/// Windows of the plots, s.
const WINDOWS: [f64; 5] = [0.02, 0.1, 0.5, 1.0, 2.0];

/// A wall as the board has it.
#[derive(Clone, Debug, PartialEq)]
pub struct WallSeen {
    /// Its shape's name.
    pub shape: String,
    /// The shape's numbers, in the order of scene files.
    pub values: Vec<f64>,
    /// The outline that is drawn of it, if it can be drawn.
    pub outline: Option<Outline>,
    /// N/m
    pub stiffness: f32,
    /// N s/m
    pub damping: f32,
    /// The kind of feed-forward of its force.
    pub feed_forward: FeedForward,
}

/// A signal over the window.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Trace {
    /// Smallest and largest value of each column.
    pub columns: Vec<(f32, f32)>,
}

/// Everything that is on the screen.
#[derive(Debug, Default)]
pub struct Seen {
    you: u64,
    /// Device, board and rates; none before the first board.
    pub hello: Value,
    /// Walls and springs of the scene.
    pub walls: Vec<WallSeen>,
    /// As the message has them.
    pub springs: Vec<Value>,
    /// The newest boundary of stable gains, as the message has it.
    pub plane: Value,
    /// The newest picture.
    pub picture: Value,
    /// The reason why there is no board; `None` while there is one.
    pub lost: Option<String>,
    /// The last thing that was refused or done, and whether it is bad.
    pub said: Option<(String, bool)>,
    again: Option<FromPage>,
    /// Wall whose gains keys turn.
    pub wall: usize,
    /// Signals that are drawn.
    pub signals: [String; 2],
    window: usize,
    /// Traces of these signals over the window.
    pub traces: Vec<Trace>,
    was_held: bool,
}

/// A number in a document; 0 where there is something else.
pub fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or(0.0)
}

/// The numbers of a document's list.
pub fn numbers(value: &Value) -> Vec<f64> {
    value.as_array().map_or(Vec::new(), |values| values.iter().map(number).collect())
}

impl Seen {
    /// Hears a message of the stage; what to ask it for then.
    pub fn hear(&mut self, text: &str) -> Option<FromPage> {
        let mut message: Value = serde_json::from_str(text).ok()?;
        let words = |message: &Value, key: &str| message[key].as_str().unwrap_or_default().to_string();
        match message["is"].as_str()? {
            "you" => self.you = message["you"].as_u64().unwrap_or(0),
            "hello" => {
                self.hello = message;
                (self.lost, self.traces) = (None, Vec::new());
                let known = self.columns();
                for (signal, usual) in self.signals.iter_mut().zip(["rendered_n", "distance_m"]) {
                    if !known.contains(signal) {
                        *signal = known.iter().find(|name| *name == usual).or(known.first())?.clone();
                    }
                }
                return self.request();
            }
            "walls" => {
                let walls = message["walls"].as_array().map(Vec::as_slice).unwrap_or_default();
                self.walls = walls.iter().filter_map(wall).collect();
                // A question about gains goes with the gains that it was about.
                if self.again.take().is_some() {
                    self.said = None;
                }
                self.wall = self.wall.min(self.walls.len().saturating_sub(1));
                self.springs = message["springs"].as_array().cloned().unwrap_or_default();
            }
            "plane" => self.plane = message["plane"].take(),
            "picture" => self.picture = message,
            "refused" => {
                self.again = serde_json::from_value(message["again"].take()).ok();
                self.said = Some((words(&message, "why"), true));
            }
            "recorded" => self.said = Some((words(&message, "words"), false)),
            "lost" => {
                (self.lost, self.picture) = (Some(words(&message, "why")), Value::Null);
                self.traces.clear();
            }
            _ => {}
        }
        None
    }

    /// A sweep, as [`crate::view::scope::Scope::bytes`] packs it.
    pub fn sweep(&mut self, bytes: &[u8]) {
        let mut floats = bytes.chunks_exact(4).filter_map(|four| Some(f32::from_le_bytes(four.try_into().ok()?)));
        let head: Vec<f32> = floats.by_ref().take(6).collect();
        let [_, _, _, _, channels, columns] = head[..] else { return };
        let rest: Vec<f32> = floats.collect();
        let pairs = rest.chunks_exact(2).map(|pair| (pair[0], pair[1]));
        let pairs: Vec<(f32, f32)> = pairs.collect();
        let traces = pairs.chunks_exact((columns as usize).max(1)).take(channels as usize);
        self.traces = traces.map(|columns| Trace { columns: columns.to_vec() }).collect();
    }

    fn columns(&self) -> Vec<String> {
        let columns = self.hello["columns"].as_array().map(Vec::as_slice).unwrap_or_default();
        columns.iter().filter_map(Value::as_str).map(Into::into).collect()
    }

    /// Time that the plots show, s.
    pub fn seconds(&self) -> f64 {
        WINDOWS[(self.window + 3) % WINDOWS.len()]
    }

    fn request(&self) -> Option<FromPage> {
        let known = !self.signals[0].is_empty();
        let request = ScopeRequest { channels: self.signals.to_vec(), seconds: self.seconds(), trigger: None };
        known.then_some(FromPage::Scope(request))
    }

    /// The largest stiffness (N/m) that is predicted to be stable with the damping and the feed-forward of the wall at
    /// hand, and the frequency (Hz) at which a stiffer one begins to buzz; none where that wall is not the nearest, or
    /// its boundary not worked out.
    pub fn stable_to(&self) -> Option<(f64, Option<f64>)> {
        let wall = self.walls.get(self.wall).filter(|_| self.plane["wall"] == self.wall)?;
        let plane: Plane = serde_json::from_value(self.plane.clone()).ok()?;
        let damping = f64::from(wall.damping);
        let boundary = plane.boundary(wall.feed_forward);
        let beside = boundary.get(boundary.partition_point(|point| point.kd < damping));
        Some((plane.stiffness_to(wall.feed_forward, damping), beside.and_then(|point| point.hz)))
    }

    /// Draws the next signal in one of the plots.
    pub fn next_signal(&mut self, plot: usize) -> Option<FromPage> {
        let columns = self.columns();
        let now = columns.iter().position(|name| *name == self.signals[plot]).unwrap_or(0);
        self.signals[plot] = columns.get((now + 1) % columns.len().max(1))?.clone();
        self.request()
    }

    /// Shows another span of time.
    pub fn next_window(&mut self) -> Option<FromPage> {
        self.window = (self.window + 1) % WINDOWS.len();
        self.request()
    }

    /// Turns to the next wall.
    pub fn next_wall(&mut self) {
        self.wall = (self.wall + 1) % self.walls.len().max(1);
    }

    /// Other gains of the wall at hand; `next` kind of feed-forward.
    pub fn gains(&mut self, stiffness: f32, damping: f32, next: bool) -> Vec<FromPage> {
        (self.said, self.again) = (None, None);
        let Some(wall) = self.walls.get(self.wall) else { return Vec::new() };
        let kinds = FeedForward::ALL;
        let feed_forward = kinds[(wall.feed_forward as usize + usize::from(next)) % kinds.len()].1;
        vec![FromPage::Gains {
            wall: self.wall as u8,
            stiffness: stiffness * wall.stiffness,
            damping: damping * wall.damping,
            feed_forward,
            beyond: false,
        }]
    }

    /// The last message that was refused, to send it again now that somebody has confirmed it.
    pub fn again(&mut self) -> Option<FromPage> {
        self.said = None;
        self.again.take()
    }

    /// Leads the hand on from where it is, m; where the device is simulated.
    pub fn lead(&mut self, x: f64, y: f64) -> Option<FromPage> {
        if self.hello["simulated"] != true {
            self.said = Some(("this device is not simulated: take it into your own hand".into(), true));
            return None;
        }
        let tip = self.tip();
        let goal = numbers(&self.picture["hand"]["goal"]);
        let at = match (self.arc(), goal.as_slice(), tip.as_slice()) {
            (None, [from_x, from_y, ..], _) | (None, [], [from_x, from_y, ..]) => [from_x + x, from_y + y],
            // A step along the arc.
            (Some(radius), goal, [tip_x, tip_y, ..]) => {
                let from = goal.first().copied().unwrap_or(radius * tip_y.atan2(*tip_x));
                let (sin, cos) = (from / radius).sin_cos();
                [from - x * sin + y * cos, 0.0]
            }
            _ => return None,
        };
        // Two keys between two pictures are two steps.
        self.picture["hand"]["goal"] = at.to_vec().into();
        Some(FromPage::Hand { at: Some(at) })
    }

    /// Radius of the arc that the task is a length of, m: a paddle's.
    fn arc(&self) -> Option<f64> {
        let [from, to] = [0, 1].map(|end| numbers(&self.picture["geometry"]["bars"][0][end]));
        let radius = (to.first()? - from.first()?).hypot(to.get(1)? - from.get(1)?);
        (self.hello["task"] == 1).then_some(radius)
    }

    /// The position of a place of the task, m, in the plane that is drawn.
    pub fn placed(&self, place: (f64, f64)) -> (f64, f64) {
        self.arc().map_or(place, |radius| (radius * (place.0 / radius).cos(), radius * (place.0 / radius).sin()))
    }

    /// The tip in the plane that is drawn, m.
    pub fn tip(&self) -> Vec<f64> {
        numbers(&self.picture["geometry"]["tip"])
    }

    /// Returns true if this terminal commands.
    pub fn commands(&self) -> bool {
        self.picture["command"] == self.you
    }

    /// Takes command, or gives it back.
    pub fn take_or_give(&self) -> FromPage {
        if self.commands() { FromPage::Give {} } else { FromPage::Take {} }
    }

    /// Returns true while a recording is under way.
    pub fn is_recording(&self) -> bool {
        !self.picture["recording"].is_null()
    }

    /// The newest control step that was told.
    pub fn step(&self) -> u32 {
        self.picture["step"].as_u64().unwrap_or(0) as u32
    }

    /// Returns true while the stage holds the motors on for a key.
    pub fn held(&self) -> bool {
        self.picture["held"] == true
    }

    /// Returns true if the stage held the motors on when this terminal last held a key.
    pub fn was_held(&self) -> bool {
        self.was_held
    }

    /// Notes that, while the key is down.
    pub fn remember_held(&mut self, down: bool) {
        self.was_held = down && (self.was_held || self.held());
    }
}

fn wall(value: &Value) -> Option<WallSeen> {
    Some(WallSeen {
        shape: value["shape"].as_str()?.into(),
        values: numbers(&value["values"]),
        outline: serde_json::from_value(value["outline"].clone()).ok(),
        stiffness: value["stiffness"].as_f64()? as f32,
        damping: value["damping"].as_f64()? as f32,
        feed_forward: serde_json::from_value(value["feed_forward"].clone()).ok()?,
    })
}
