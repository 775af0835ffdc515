//! The states of the control loop, and the faults that turn the motors off, each with a remedy.
//!
//! Motors are off unless armed; every fault turns them off within the step that sees it and stays until cleared.

use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

/// The state of the motors.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub enum State {
    /// Bridges float; the device moves freely.
    #[default]
    Disarmed,
    /// The scene is rendered.
    Armed,
    /// One joint at a time is moved by a small torque, to see that motor and encoder agree.
    CheckingPolarity,
    /// Bridges float until the fault is cleared.
    Fault,
}

impl State {
    /// Every state, in the order of the numbers that telemetry gives them.
    pub const ALL: [Self; 4] = [Self::Disarmed, Self::Armed, Self::CheckingPolarity, Self::Fault];

    /// Returns true if the bridges drive the motors.
    pub const fn drives(self) -> bool {
        match self {
            Self::Armed | Self::CheckingPolarity => true,
            Self::Disarmed | Self::Fault => false,
        }
    }
}

/// The words after `haptic` that clear a fault, as remedies tell them to a person; other programs' have their own.
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

            /// Its number in logs.
            pub const fn code(self) -> u8 {
                self as u8
            }

            /// The event, in plain words.
            pub const fn what(self) -> &'static str {
                match self { $(Fault::$Name => $what,)* }
            }

            /// The remedy that a person can apply.
            pub const fn remedy(self) -> &'static str {
                match self { $(Fault::$Name => $remedy,)* }
            }

            /// The name in logs and documents.
            pub const fn name(self) -> &'static str {
                match self { $(Fault::$Name => stringify!($Name),)* }
            }
        }
    };
}

faults! {
    /// The control step did not finish in its period; value: periods missed.
    ControlOverrun = 1, "the control step did not finish within its period",
        "lower the scene's rate_hz, or give it fewer walls with feed-forward";
    /// An encoder moved further in one step than the speed limit allows; value: counts.
    EncoderJump = 2, "an encoder jumped further in one step than the device can move",
        "check the encoder's cable, shield and supply; keep it short and away from wires that carry motor current";
    /// Torque near its limit without any motion; value: seconds.
    EncoderStall = 3, "a motor pushed hard for seconds and its encoder did not move at all",
        "check that the encoder is connected and the joint not blocked, then home again";
    /// The measured back-EMF says the joint turns and the encoder does not; value: rad/s.
    EncoderLoss = 4, "the motor turns but its encoder does not",
        "check the encoder's cable and coupling, then home again";
    /// Both encoder lines changed at once; value: errors seen.
    EncoderIllegal = 5, "both lines of an encoder changed at once",
        "check the encoder's cable; a line may be broken or picking up noise";
    /// The index came at another count than before; value: counts off.
    IndexMismatch = 6, "the encoder's index came at the wrong count: counts were lost",
        "check the encoder's cable, then home again";
    /// A joint left its limits; value: rad.
    JointLimit = 7, "a joint left its limits",
        "move the device back by hand, then `haptic faults --clear` and arm again";
    /// A joint exceeded its speed limit; value: rad/s.
    SpeedLimit = 8, "a joint moved faster than its limit",
        "lower the stiffness or raise the damping; if the encoder is noisy, check its cable";
    /// A motor's current exceeded its limit by far; value: A.
    OverCurrent = 9, "a motor's current exceeded its limit",
        "check the motor for a short, and resistance and inductance in the device file";
    /// A motor has been working too hard for too long; value: fraction of the budget.
    ThermalBudget = 10, "a motor has spent its thermal budget (I²t)",
        "let it cool for a minute; lower the stiffness, or the current limit";
    /// The bus voltage is too low; value: V.
    BusUnderVoltage = 11, "the supply voltage is too low", "check the supply and its current limit";
    /// The bus voltage is too high; value: V.
    BusOverVoltage = 12, "the supply voltage is too high",
        "braking motors feed the supply: use one that can sink, or a brake resistor";
    /// The gate driver pulled its fault pin; value: its status register.
    GateDriver = 13, "the gate driver reports a fault", "check for shorts at the motor terminals, then `haptic faults --clear`";
    /// A number in the control step was infinite or not a number.
    NotFinite = 14, "a number in the control step was not finite",
        "reload the device and the scene; report it with both files if it returns";
    /// The linkage reached a pose where its tip force is not defined; value: sine of the angle left.
    Singularity = 15, "the linkage is stretched to a singular pose",
        "move the device back by hand; set joint limits that exclude the pose";
    /// No message from the host for too long; value: seconds.
    HostLost = 16, "the host has not been heard for too long",
        "check the cable and the program that sends heartbeats; `haptic rules --host-seconds` allows a longer silence, `haptic rules --host ignore` any";
    /// The independent watchdog reset the board.
    Watchdog = 17, "the watchdog reset the board: the control loop or a task had stopped",
        "lower the scene's rate_hz if it is above 30000; if not, note what was done before, save the log, and report it";
    /// The stack reached its guard.
    StackOverflow = 18, "the stack overflowed", "report it with device and scene files";
    /// Settings in flash were damaged and replaced by defaults; value: how many.
    SettingsDamaged = 19, "some settings in flash were damaged and are at their defaults",
        "restore a backup with `haptic board restore`, or load device and scene again";
    /// The processor took a hard fault; value: the address.
    HardFault = 20, "the processor stopped at a hard fault", "report it with device and scene files";
    /// The firmware panicked; value: the line.
    Panic = 21, "the firmware stopped at a panic", "report it with device and scene files";
    /// The break input cut the bridges in hardware.
    BreakInput = 22, "the break input cut the bridges", "release the emergency stop, then `haptic faults --clear`";
    /// Mean power into the hand exceeded its limit; value: W.
    PowerLimit = 23, "more power went into the hand than its limit allows",
        "lower the stiffness or raise the damping; the wall is unstable or the limit too tight";
    /// Motor and encoder disagree about which way is positive; value: rad moved.
    PolarityWrong = 24, "a motor turned its joint the wrong way",
        "swap the motor's two wires, or set `inverted` of that joint's encoder in the device file";
    /// No motion under more torque than the joint's inertia and friction need by the file.
    PolarityNoMotion = 25, "a joint did not move under the test torque",
        "free the joint, check motor wires and encoder; give friction that takes more than half a newton at the tip as `coulomb` in the device file, and see that the tip's limit is more; then check again";
    /// The control interrupt's inputs went stale (ADC or SPI stopped); value: periods.
    SensorStale = 26, "a measurement of the board stopped arriving", "power-cycle the board; report it if it returns";
    /// Two sensors of one motor's current disagree; value: A.
    CurrentSensor = 27, "the two current sensors of a motor disagree",
        "power-cycle the board; if it returns, a shunt, its amplifier or a third phase's wire is at fault";
    /// Voltage, current and speed of a motor do not belong together; value: V unaccounted for.
    MotorModel = 28, "a motor's voltage, current and speed contradict each other",
        "check the motor's wires, its encoder's direction and coupling, the current sensor, and resistance, inductance and back-EMF in the device file";
    /// A gate driver forgot its settings while the motors were on; value: the register as it was read.
    DriverReset = 29, "a gate driver lost its settings while the motors were on",
        "check the supply for dips and the driver's soldering, then `haptic faults --clear`";
    /// Current flows though the bridges are off; value: A.
    StrayCurrent = 30, "current flows through a motor though the bridges are off",
        "switch the supply off: a switch of the bridge is broken, or a motor wire touches another; or a current sensor is off its zero";
    /// The clock security system found the crystal dead.
    ClockFailure = 31, "the crystal that clocks the processor stopped",
        "power-cycle the board; if it returns, the crystal or its soldering is at fault";
    /// The supply monitor saw the processor's own supply fall.
    SupplyDip = 32, "the processor's own supply dipped",
        "check the supply of the board's 3.3 V, and what else it feeds";
    /// The image in flash is not as it was built.
    ImageDamaged = 33, "the firmware in flash is not as it was built",
        "flash the board again, with an image made by `cargo fw`";
    /// A word of RAM did not keep what was written; value: its address.
    RamDamaged = 34, "the processor's RAM does not keep what is written",
        "power-cycle the board; if it returns, replace the board";
    /// A joint kept moving when the polarity check was to begin with it; value: rad from where it stood last.
    PolarityUnrest = 35, "a joint did not come to rest for the polarity check",
        "let the device stand still by itself, or hold it still for a moment, hands off while a motor pushes; then check again";
    /// A dead man's key that was held is no longer told of; value: seconds since it was seen down.
    KeyReleased = 36, "nobody was heard to hold the dead man's key any more",
        "`haptic faults --clear`, then press the key anew; if it comes while the key is down, the page, the network or the computer between key and board is too slow";
    /// The image is for another board than the chip is on; value: the pin that told, 16 times its port (0 for A) and its number.
    WrongBoard = 37, "the firmware is for another board than this",
        "flash this board's own image; if it is this board's, look at the wire of its bus divider";
    /// The currents that are measured push harder at the tip than they may; value: N.
    ForceLimit = 38, "the measured currents push harder at the tip than its limit allows",
        "lower the damping or the stiffness; if it returns at rest, check the current sensors and the motor data in the device file";
    /// A joint is not driven by its motor's current as the device file says; value: the torque that acted over the file's, or how many
    /// times as far as planned a joint was swung.
    TorqueMismatch = 39, "a joint's motion does not fit its motor's current",
        "the value is the torque that acted over the file's: check torque_constant with its gear ratio, the motors' order, counts_per_turn, the inertias and the current sensor, hands off; then check again";
    /// A winding's resistance is not the device file's; value: Ω.
    ResistanceMismatch = 40, "a motor's resistance is not the one in its device file",
        "measure the winding at the motor's terminals: write that into the file, or the current sensor or a contact is at fault";
}

impl Fault {
    /// Returns true if the joint angles can no longer be trusted: the device has to be homed again.
    pub const fn loses_counts(self) -> bool {
        matches!(
            self,
            Self::EncoderJump | Self::EncoderStall | Self::EncoderLoss | Self::EncoderIllegal | Self::IndexMismatch
        )
    }
}

impl core::fmt::Display for Fault {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        write!(f, "{} ({}): {}", self.name(), self.code(), self.what())
    }
}

/// A fault as it happened.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct FaultRecord {
    /// The fault.
    pub fault: Fault,
    /// Which axis, where one is meant.
    pub axis: Option<u8>,
    /// The number that was wrong, in the unit its fault names.
    pub value: f32,
    /// Control steps since boot.
    pub step: u32,
}

#[cfg(test)]
mod tests {
    use postcard_schema::Schema;
    use serde::{Deserialize, Serialize};

    faults! {
        /// The handle was let go of; value: seconds.
        LetGo = 3, "the handle was let go of", "hold it, then `haptic faults --clear`";
        /// The handle is hot; value: kelvin.
        HotHandle = 7, "the handle is hot", "let it cool";
    }

    /// Everything that is told of a fault follows from its line.
    #[test]
    fn a_toy_fault_is_one_line() {
        let told = |fault: &Fault| (fault.code(), fault.name(), fault.what(), fault.remedy());
        let told_of_all = [
            (3, "LetGo", "the handle was let go of", "hold it, then `haptic faults --clear`"),
            (7, "HotHandle", "the handle is hot", "let it cool"),
        ];
        assert!(Fault::ALL.iter().map(told).eq(told_of_all));
    }
}
