/* haptic-bridge boards for programs in C: libhapticbridge.
 *
 * Functions that can fail return HB_OK or another code; hb_error() then returns the message. Every function may
 * be called from any thread; calls on one board wait for each other. All numbers are in SI units. Vectors are in the
 * task frame or have one entry per joint, with zeros in entries that the device does not have.
 *
 * Generated from clients/c/src/lib.rs by cbindgen. */

#ifndef HAPTICBRIDGE_H
#define HAPTICBRIDGE_H

#include <stdint.h>

/*
 Version of this header. A library of another version has other structures: compare with hb_version().
 */
#define HB_VERSION 3

/*
 Return value of a function: success.
 */
#define HB_OK 0

/*
 Return value of a function: failure, such as no board, a refusal or a wrong file.
 */
#define HB_FAILED 1

/*
 Return value of a function: an argument is NULL, not UTF-8, not finite or out of range.
 */
#define HB_BAD_ARGUMENT 2

/*
 Return value of a function: a defect of the library, which has disarmed the board.
 */
#define HB_BROKEN 3

/*
 Return value of a function: no reply in time, because the board or the computer was busy or a frame was lost.
 */
#define HB_UNANSWERED 4

/*
 Return value of a function: the connection was lost. Close the board, and open it once it is connected again.
 */
#define HB_LOST 5

/*
 hb_state.done: the request acts (docs/host-force.md).
 */
#define HB_TAKEN 0

/*
 hb_state.done: hold and fade are 0, so the request only read the state.
 */
#define HB_LOOKED 1

/*
 hb_state.done: the request does not act, because the motors are off.
 */
#define HB_NOT_ARMED 2

/*
 hb_state.done: the request does not act, because a request with the same or a later number acts.
 */
#define HB_NOT_NEWER 3

/*
 hb_state.done: the request does not act, because more time than hold and fade has passed since the last call.
 */
#define HB_TOO_OLD 4

/*
 hb_state.done: the request does not act, because one of its numbers is invalid. hb_error() names the number.
 */
#define HB_BAD 5

/*
 hb_state.state: the motors are off.
 */
#define HB_DISARMED 0

/*
 hb_state.state: the motors are on.
 */
#define HB_ARMED 1

/*
 hb_state.state: the polarity check turns the motors on one after the other, with a small torque.
 */
#define HB_CHECKING_POLARITY 2

/*
 hb_state.state: the motors are off until hb_clear(). hb_state.fault and hb_error() give the reason.
 */
#define HB_FAULT 3

/*
 hb_state.state: `haptic home --key` pushes the joints to their stops one after the other.
 */
#define HB_HOMING 4

/*
 A board that this program holds.
 */
typedef struct hb_board hb_board;

/*
 A request to the motors, which replaces the previous request. A request of zeros only reads the state.
 */
typedef struct {
  /*
   Time for which the request acts in full, 0 to 0.2.
   */
  float hold_s;
  /*
   Time in which the request then fades to zero, 0 to 0.2.
   */
  float fade_s;
  /*
   Force at the tip.
   */
  float force_n[3];
  /*
   Joint torques.
   */
  float torque_nm[3];
  /*
   1 if the board renders the plane of the next four fields, otherwise 0.
   */
  int32_t has_contact;
  /*
   A point on the plane.
   */
  float point_m[3];
  /*
   Unit normal of the plane, which points out of the solid.
   */
  float normal[3];
  /*
   Stiffness of the plane.
   */
  float stiffness_n_m;
  /*
   Damping of the plane.
   */
  float damping_ns_m;
} hb_request;

/*
 State of the device.
 */
typedef struct {
  /*
   HB_TAKEN, or the reason why the request does not act.
   */
  int32_t done;
  /*
   HB_DISARMED, HB_ARMED, HB_CHECKING_POLARITY, HB_FAULT or HB_HOMING.
   */
  int32_t state;
  /*
   Number of control steps since the board started, which wraps at 2^32.
   */
  uint32_t step;
  /*
   Period of the control steps.
   */
  float period_s;
  /*
   Age of the state from which the acting request was computed; negative if no request acts.
   */
  float age_s;
  /*
   Share of the request that acts.
   */
  float share;
  /*
   Position of the tip.
   */
  float tip_m[3];
  /*
   Velocity of the tip.
   */
  float velocity_m_s[3];
  /*
   Joint angles. Of a slide its travel, m, and so are its speed, m/s, and its force, N.
   */
  float q_rad[3];
  /*
   Commanded joint torques, after all limits.
   */
  float torque_nm[3];
  /*
   Force that the host's force and contact have added at the tip.
   */
  float force_n[3];
  /*
   Joint velocities.
   */
  float qd_rad_s[3];
  /*
   Code of the latched fault, see hb_fault_text(); 0 without a fault.
   */
  int32_t fault;
  /*
   Angles of the encoders without motors.
   */
  float sensed_rad[3];
} hb_state;

#ifdef __cplusplus
extern "C" {
#endif // __cplusplus

/*
 Returns the HB_VERSION of the library.
 */
uint32_t hb_version(void);

/*
 Returns the message of the last failed call of this thread. After hb_exchange() the message can also be the reason
 of HB_BAD or the latched fault. The pointer is never NULL and stays the same for the life of the thread.
 */
const char *hb_error(void);

/*
 Returns the meaning and the remedy of a fault code from hb_state.fault; an empty text for an unknown code.
 */
const char *hb_fault_text(int32_t fault);

/*
 Opens a board. `port` is a serial port or serial number, tcp:HOST:PORT, sim, sim:DEVICE.toml, or NULL for the only
 connected board. Returns NULL if the board cannot be opened.
 */
hb_board *hb_open(const char *port);

/*
 Disarms the board and closes it. NULL is allowed.
 */
void hb_close(hb_board *board);

/*
 Loads a device file and a scene file; a NULL scene is free space. The motors must be off. The device must be homed
 again. The polarity check stays valid if the same device is loaded again and homed close to its earlier home.
 */
int32_t hb_load(const hb_board *board, const char *device_file, const char *scene_file);

/*
 Loads a scene file for the present device, which stays homed; NULL is free space. The motors must be off.
 */
int32_t hb_set_scene(const hb_board *board, const char *scene_file);

/*
 Declares that the device is in its home pose.
 */
int32_t hb_home(const hb_board *board);

/*
 Checks that every motor turns its joint in the direction in which the encoder counts. Moves each joint a little and
 waits for the end of the check. Returns HB_OK only if all joints pass.
 */
int32_t hb_check_polarity(const hb_board *board);

/*
 Turns the motors on; the torque ramps up over 0.5 s. hb_exchange(), also with NULL, must then be called as often as
 the board's rules require a heartbeat, by default every 0.5 s.
 */
int32_t hb_arm(const hb_board *board);

/*
 Turns the motors off.
 */
int32_t hb_disarm(const hb_board *board);

/*
 Clears a latched fault.
 */
int32_t hb_clear(const hb_board *board);

/*
 Sets the time for which hb_exchange() waits for its reply, s. By default it waits for 0.1 s and retries for 1 s in
 total. A program with a faster loop sets a shorter time, which limits the delay by a lost frame.
 */
int32_t hb_wait_for_forces(const hb_board *board, double seconds);

/*
 Sends a request (NULL only reads the state) and waits for the reply, usually less than a millisecond. Returns
 HB_UNANSWERED without a reply, see hb_wait_for_forces(). A refused request is not a failure; hb_state.done gives the
 reason. Allocates no memory after the first calls, except for messages for hb_error().
 */
int32_t hb_exchange(const hb_board *board, const hb_request *request, hb_state *state);

#ifdef __cplusplus
}  // extern "C"
#endif  // __cplusplus

#endif  /* HAPTICBRIDGE_H */
