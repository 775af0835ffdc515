//! The states of the control loop, and the faults that turn the motors off, each with a remedy.
//!
//! Motors are off unless armed. A fault turns the motors off in the step that detects it, and stays until cleared.

use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

/// The state of the motors.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub enum State {
    /// Bridges float, so the device moves freely.
    #[default]
    Disarmed,
    /// The scene is rendered.
    Armed,
    /// A small torque moves one joint at a time, to check that motor and encoder agree.
    CheckingPolarity,
    /// Bridges float until the fault is cleared.
    Fault,
    /// A small force pushes one joint at a time against its stop, to home the device.
    Homing,
}

impl State {
    /// Every state, in the order of its number in telemetry.
    pub const ALL: [Self; 5] = [Self::Disarmed, Self::Armed, Self::CheckingPolarity, Self::Fault, Self::Homing];

    /// Returns true if the bridges drive the motors.
    pub const fn drives(self) -> bool {
        match self {
            Self::Armed | Self::CheckingPolarity | Self::Homing => true,
            Self::Disarmed | Self::Fault => false,
        }
    }
}

/// Arguments of `haptic` that clear a fault. Other programs replace these words in a remedy by their own command.
pub const CLEARING: &str = "faults --clear";

macro_rules! faults {
    ($($(#[$doc:meta])* $Name:ident = $code:literal, $what:literal, $remedy:literal;)*) => {
        /// The faults, each with a code that never changes.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize, Schema)]
        #[repr(u8)]
        pub enum Fault { $($(#[$doc])* $Name = $code,)* }

        impl Fault {
            /// Every fault, in the order of their codes.
            pub const ALL: &'static [Fault] = &[$(Fault::$Name),*];

            /// Returns the number in logs.
            pub const fn code(self) -> u8 {
                self as u8
            }

            /// Returns the description of the event for people.
            pub const fn what(self) -> &'static str {
                match self { $(Fault::$Name => $what,)* }
            }

            /// Returns the remedy that a person can apply.
            pub const fn remedy(self) -> &'static str {
                match self { $(Fault::$Name => $remedy,)* }
            }

            /// Returns the name in logs and documents.
            pub const fn name(self) -> &'static str {
                match self { $(Fault::$Name => stringify!($Name),)* }
            }
        }
    };
}

faults! {
    /// The control step did not finish in its period; value: number of missed periods.
    ControlOverrun = 1, "the control step did not finish within its period",
        "lower the scene's rate_hz, or give it fewer walls with feed-forward";
    /// An encoder moved further in one step than the speed limit allows; value: counts.
    EncoderJump = 2, "an encoder jumped further in one step than the device can move",
        "check the encoder's cable, shield and supply; keep the cable short and away from wires that carry motor current";
    /// A torque near its limit moved no encoder; value: time, s.
    EncoderStall = 3, "a motor pushed hard for seconds and its encoder did not move at all",
        "check that the encoder is connected and the joint is not blocked, then home again";
    /// The measured back-EMF shows that the joint moves, but the encoder does not; value: rad/s, of a slide m/s.
    EncoderLoss = 4, "the motor turns but its encoder does not",
        "check the encoder's cable and coupling, then home again";
    /// Both encoder lines changed at once; value: number of errors.
    EncoderIllegal = 5, "both lines of an encoder changed at once",
        "check the encoder's cable; a line may be broken or picking up noise";
    /// An index pulse came at another count than before; value: difference, counts.
    IndexMismatch = 6, "the encoder's index came at the wrong count: counts were lost",
        "check the encoder's cable, then home again";
    /// A joint left its limits; value: rad, of a slide m.
    JointLimit = 7, "a joint left its limits",
        "move the device back by hand, then `haptic faults --clear` and arm again";
    /// A joint exceeded its speed limit; value: rad/s, of a slide m/s.
    SpeedLimit = 8, "a joint moved faster than its limit",
        "lower the stiffness or raise the damping; if the encoder is noisy, check its cable";
    /// A motor's current exceeded its limit by far; value: A.
    OverCurrent = 9, "a motor's current exceeded its limit",
        "check the motor for a short, and resistance and inductance in the device file";
    /// A motor has spent its thermal budget; value: share of the budget.
    ThermalBudget = 10, "a motor has spent its thermal budget (I²t)",
        "let the motor cool for a minute; lower the stiffness, or the current limit";
    /// The bus voltage is too low; value: V.
    BusUnderVoltage = 11, "the supply voltage is too low", "check the supply and its current limit";
    /// The bus voltage is too high; value: V.
    BusOverVoltage = 12, "the supply voltage is too high",
        "braking motors feed current into the supply: use a supply that can sink current, or a brake resistor";
    /// The gate driver asserted its fault pin; value: its status register.
    GateDriver = 13, "the gate driver reports a fault", "check for shorts at the motor terminals, then `haptic faults --clear`";
    /// A number in the control step was infinite or not a number.
    NotFinite = 14, "a number in the control step was not finite",
        "reload the device and the scene; if the fault returns, report it with both files";
    /// The linkage reached a pose where its tip force is not defined; value: sine of the remaining angle.
    Singularity = 15, "the linkage is stretched to a singular pose",
        "move the device back by hand; set joint limits that exclude the pose";
    /// The host has sent no sign of life for too long; value: time, s.
    HostLost = 16, "the host has sent no sign of life for too long",
        "check the cable and the program that sends heartbeats; `haptic rules --host-seconds` allows a longer silence, `haptic rules --host ignore` any silence";
    /// The independent watchdog reset the board.
    Watchdog = 17, "the watchdog reset the board: the control loop or a task had stopped",
        "lower the scene's rate_hz if it is above 30000; otherwise note the last actions, save the log, and report the fault";
    /// The stack has reached its guard.
    StackOverflow = 18, "the stack overflowed", "report the fault with device and scene files";
    /// Settings in flash were damaged and replaced by defaults; value: number of settings.
    SettingsDamaged = 19, "some settings in flash were damaged and are at their defaults",
        "restore a backup with `haptic board restore`, or load device and scene again";
    /// The processor took a hard fault; value: address.
    HardFault = 20, "the processor stopped at a hard fault", "report the fault with device and scene files";
    /// The firmware panicked; value: line number.
    Panic = 21, "the firmware stopped at a panic", "report the fault with device and scene files";
    /// The break input cut the bridges in hardware.
    BreakInput = 22, "the break input cut the bridges", "release the emergency stop, then `haptic faults --clear`";
    /// Mean power into the hand exceeded its limit; value: W.
    PowerLimit = 23, "more power went into the hand than its limit allows",
        "lower the stiffness or raise the damping; the wall is unstable or the limit too tight";
    /// Motor and encoder disagree about the positive direction; value: actual over planned torque or swing.
    PolarityWrong = 24, "a motor turned its joint the wrong way",
        "swap the motor's two wires, or set `inverted` of that joint's encoder in the device file";
    /// A joint did not move under more torque than its inertia and friction need according to the device file.
    PolarityNoMotion = 25, "a joint did not move under the test torque",
        "free the joint, check motor wires and encoder; if friction takes more than half a newton at the tip, set it as `coulomb` in the device file, and set the force limit at the tip above it; then check again";
    /// The inputs of the control interrupt stopped arriving (ADC or SPI); value: number of periods.
    SensorStale = 26, "a measurement of the board stopped arriving", "power-cycle the board; report the fault if it returns";
    /// Two sensors of one motor's current disagree; value: A.
    CurrentSensor = 27, "the two current sensors of a motor disagree",
        "power-cycle the board; if the fault returns, a shunt, its amplifier or a third phase's wire is at fault";
    /// Voltage, current and speed of a motor contradict each other; value: unexplained voltage, V.
    MotorModel = 28, "a motor's voltage, current and speed contradict each other",
        "check the motor's wires, its encoder's direction and coupling, the current sensor, and resistance, inductance and back-EMF in the device file";
    /// A gate driver lost its settings while the motors were on; value: the register as read.
    DriverReset = 29, "a gate driver lost its settings while the motors were on",
        "check the supply for dips and the driver's soldering, then `haptic faults --clear`";
    /// Current flows although the bridges are off; value: A.
    StrayCurrent = 30, "current flows through a motor though the bridges are off",
        "switch the supply off: a switch of the bridge is broken, a motor wire touches another, or a current sensor's zero is wrong";
    /// The clock security system detected that the crystal stopped.
    ClockFailure = 31, "the crystal that clocks the processor stopped",
        "power-cycle the board; if the fault returns, the crystal or its soldering is at fault";
    /// The supply monitor detected a dip of the processor's own supply.
    SupplyDip = 32, "the processor's own supply dipped",
        "check the supply of the board's 3.3 V, and everything else that it feeds";
    /// The image in flash differs from the image as built.
    ImageDamaged = 33, "the firmware in flash is not as it was built",
        "flash the board again, with an image made by `cargo fw`";
    /// A word of RAM did not keep what was written; value: the word's address.
    RamDamaged = 34, "the processor's RAM does not keep what is written",
        "power-cycle the board; if the fault returns, replace the board";
    /// A joint kept moving when the polarity check was about to start with it; value: motion, rad, of a slide m.
    PolarityUnrest = 35, "a joint did not come to rest for the polarity check",
        "let the device come to rest, or hold it still for a moment; take your hands off while a motor pushes; then check again";
    /// A held dead man's key is no longer reported as held; value: time since it was last seen down, s.
    KeyReleased = 36, "the dead man's key is no longer reported as held",
        "`haptic faults --clear`, then press the key again; if the fault comes while the key is down, the page, the network or the computer between key and board is too slow";
    /// The image is for another board; value: the pin that differs, 16 times its port (0 for A) plus its number.
    WrongBoard = 37, "the firmware is for another board than this",
        "flash the image of this board; if the image is right, check the wire of the bus divider";
    /// The measured currents make more force at the tip than the limit allows; value: N.
    ForceLimit = 38, "the measured currents push harder at the tip than its limit allows",
        "lower the damping or the stiffness; if the fault returns at rest, check the current sensors and the motor data in the device file";
    /// A motor's current does not drive its joint as the device file says; value: actual over planned torque or swing.
    TorqueMismatch = 39, "a joint's motion does not fit its motor's current",
        "the value is the actual torque over the torque of the device file: check torque_constant with its gear ratio, the motors' order, counts_per_turn, the inertias and the current sensor; take your hands off, then check again";
    /// A winding's resistance differs from the resistance in the device file; value: Ω.
    ResistanceMismatch = 40, "a motor's resistance is not the one in its device file",
        "measure the winding at the motor's terminals: correct the device file if it is wrong; otherwise the current sensor or a contact is at fault";
    /// A joint did not stand still at its stop, twice at the same angle; value: error of the angle, or motion, rad.
    StopMissing = 41, "a joint pushed to its stop met something else, or nothing",
        "free the joints' way to their stops and keep hands off; check `stop` and `limits` in the device file; hold the device in its home pose and run `haptic home`, then `haptic polarity` and `haptic home --key`";
    /// A three-phase motor has another number of pole pairs than its device file; value: pole pairs found.
    PolePairs = 42, "a motor's pole pairs are not those of its device file",
        "the value is the number found: correct pole_pairs, ratio and counts_per_turn in the device file; take your hands off, then check again";
    /// Three frames of an absolute encoder in a row were invalid or an impossible motion; value: the last frame, or -1.
    EncoderFrames = 43, "three angles of an absolute encoder in a row were invalid",
        "check the encoder's magnet, supply and SPI wires; keep them short and away from wires that carry motor current";
}

impl Fault {
    /// Returns true if the joint angles may be wrong afterwards, so that the device must be homed again.
    pub const fn loses_counts(self) -> bool {
        matches!(
            self,
            Self::EncoderJump
                | Self::EncoderStall
                | Self::EncoderLoss
                | Self::EncoderIllegal
                | Self::IndexMismatch
                | Self::StopMissing
                | Self::EncoderFrames
        )
    }
}

impl core::fmt::Display for Fault {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        write!(f, "{} ({}): {}", self.name(), self.code(), self.what())
    }
}

/// An occurrence of a fault.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct FaultRecord {
    /// The fault.
    pub fault: Fault,
    /// Axis of the fault; `None` if it has no axis.
    pub axis: Option<u8>,
    /// Value at the fault, in the unit of the [`Fault`]'s documentation.
    pub value: f32,
    /// Control steps since boot.
    pub step: u32,
}

#[cfg(test)]
mod tests {
    use postcard_schema::Schema;
    use serde::{Deserialize, Serialize};

    faults! {
        /// The handle was released; value: seconds.
        Released = 3, "the handle was released", "hold it, then `haptic faults --clear`";
        /// The handle is hot; value: kelvin.
        HotHandle = 7, "the handle is hot", "let it cool";
    }

    /// Checks that all properties of a fault come from its line in the table.
    #[test]
    fn a_fault_needs_only_one_line() {
        let properties = |fault: &Fault| (fault.code(), fault.name(), fault.what(), fault.remedy());
        let expected = [
            (3, "Released", "the handle was released", "hold it, then `haptic faults --clear`"),
            (7, "HotHandle", "the handle is hot", "let it cool"),
        ];
        assert!(Fault::ALL.iter().map(properties).eq(expected));
    }
}
