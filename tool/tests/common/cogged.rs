//! Random paddles whose motors cog, with friction and a load that their files do not tell.

use haptic_bridge::model::cogging::{Compensation, Potential, Potentials};
use haptic_bridge::model::description::{Cogging, CoggingHarmonic, Description, Stribeck};
use haptic_bridge::model::device::Device;
use haptic_host::device_file::DeviceFile;
use haptic_host::link::Board;
use haptic_predict::cogging::{CoggingError, Learnt, Sweep, fit};
use haptic_sim::{BoardOptions, Options, Random, SharedBoard, SimulatedBoard};
use std::f64::consts::TAU;

/// Slots and poles of motors that are sold for gimbals and drones.
const SLOTS_AND_POLES: [(u32, u32); 5] = [(12, 14), (9, 12), (12, 16), (24, 22), (18, 20)];

/// A paddle, its file and the device on the board, which differs from the file.
pub struct CoggedPaddle {
    pub file: DeviceFile,
    /// Text of the file.
    pub text: String,
    pub wired: Description,
}

fn common_multiple(a: u32, b: u32) -> u32 {
    (1..=b).map(|i| i * a).find(|multiple| multiple % b == 0).unwrap()
}

impl CoggedPaddle {
    pub fn draw(seed: u64) -> Self {
        Self::with_arc(seed, Random::new(seed + 1_000).between(0.6, 1.3))
    }

    /// Draws a paddle with limits of ±`half_arc`, rad.
    pub fn with_arc(seed: u64, half_arc: f64) -> Self {
        let mut draw = Random::new(seed);
        let (slots, poles) = SLOTS_AND_POLES[(draw.uniform() * SLOTS_AND_POLES.len() as f64) as usize];
        let torque_constant = draw.between(0.05, 0.12);
        let counts = [4_096, 8_192, 16_384][(draw.uniform() * 3.0) as usize];
        let text = format!(
            "name = \"cogged\"\nmechanism = \"paddle\"\ngravity = [-9.81, 0.0]\n[geometry]\nlength = 0.08\n[[link]]\n\
             mass = {}\ncom = 0.03\ninertia = {}\n[[joint]]\ninertia = {}\nviscous = {}\ncoulomb = 0.001\n\
             limits = [{}, {half_arc}]\n[joint.encoder]\ncounts_per_turn = {counts}\n[joint.motor]\nkind = \"brushless\"\n\
             pole_pairs = {}\ntorque_constant = {torque_constant}\nresistance = 5.0\ninductance = 2.0e-3\n\
             max_current = 1.5\n[home]\nq = [0.0]\n",
            draw.between(0.01, 0.03),
            draw.between(1e-5, 3e-5),
            draw.between(1e-5, 4e-5),
            draw.between(1e-5, 1e-4),
            -half_arc,
            poles / 2,
        );
        let file = DeviceFile::parse(&text, "cogged.toml").unwrap();
        let mut wired = file.description;
        wired.links[0].mass *= draw.between(0.7, 1.3);
        wired.links[0].inertia *= draw.between(0.8, 1.2);
        let joint = &mut wired.joints[0];
        let most = draw.between(0.01, 0.05) * 1.5 * torque_constant;
        let mut wave = |amplitude: f64, per_turn: u32| CoggingHarmonic {
            amplitude: most * amplitude,
            per_turn: per_turn.into(),
            phase: draw.between(0.0, TAU),
        };
        let common = common_multiple(slots, poles);
        let harmonics = [wave(1.0, common), wave(0.25, 2 * common), wave(0.2, slots), wave(0.15, poles)];
        joint.cogging = Some(Cogging { harmonics });
        joint.coulomb = most * draw.between(0.3, 2.0);
        let stribeck_speed = draw.between(0.02, 0.2);
        joint.friction = Some(Stribeck { rest: joint.coulomb * draw.between(1.0, 1.5), stribeck_speed });
        Self { file, text, wired }
    }

    pub fn board(&self) -> (SharedBoard, Board) {
        let options =
            BoardOptions { device: Options { substep: 25e-6, ..Options::default() }, ..BoardOptions::default() };
        let mut simulated = SimulatedBoard::new(&self.wired, options).unwrap();
        simulated.load("cogged", &self.file.description, None).unwrap();
        let shared = SharedBoard::new(simulated);
        let board = Board::over(shared.wire(), "sim").unwrap();
        (shared, board)
    }

    /// Returns the distance of the limits, rad.
    pub fn arc(&self) -> f64 {
        self.file.description.joints[0].limits.map_or(0.0, |(low, high)| high - low)
    }

    fn device(&self) -> Device<f32> {
        self.file.device().unwrap()
    }

    /// Learns the cogging on a simulated board.
    pub fn learn(&self, board: &mut Board) -> Result<Learnt, CoggingError> {
        let mut sweep = Sweep::new(&self.device(), &board.rules()?, &board.status()?.q, 0)?;
        board.set_scene(&sweep.scene())?;
        board.arm()?;
        while !sweep.advance(board)? {}
        board.disarm()?;
        let learnt = fit(sweep.passes(), sweep.motion())?;
        board.set_cogging(&Potentials([learnt.potential.clone(), Potential::new(), Potential::new()]))?;
        Ok(learnt)
    }

    /// Returns the root mean square of the motor's cogging and of what the compensation leaves of it, within the limits.
    pub fn ripple(&self, potential: &Potential) -> (f64, f64) {
        let joint = self.device().joints[0];
        let compensation = Compensation::new(&joint, potential);
        let (low, high) = self.file.description.joints[0].limits.unwrap();
        let scale = f64::from(joint.radians_per_count);
        let counts = (low / scale) as i32..(high / scale) as i32;
        let (mut before, mut after) = (0.0, 0.0);
        for count in counts.clone() {
            let magnets =
                self.wired.joints[0].cogging.unwrap().torque(scale * f64::from(count) + f64::from(joint.offset));
            before += magnets.powi(2);
            after += (magnets + f64::from(compensation.torque(count))).powi(2);
        }
        let number = counts.len() as f64;
        ((before / number).sqrt(), (after / number).sqrt())
    }
}
