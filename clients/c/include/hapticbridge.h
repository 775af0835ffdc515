/* haptic-bridge boards for programs in C: libhapticbridge.
 *
 * Functions that can fail return HB_OK or another code; hb_error() then says what went wrong, in words. Every function may
 * be called from any thread; calls on one board wait for each other. SI units; vectors are in the task frame or one entry
 * a joint, with zeros in entries that the device does not have.
 *
 * Made of clients/c/src/lib.rs by cbindgen. */

#ifndef HAPTICBRIDGE_H
#define HAPTICBRIDGE_H

#include <stdint.h>

/*
 Of this header. A library of another number has other structures: compare with hb_version().
 */
#define HB_VERSION 2

/*
 What a function returns: it was done.
 */
#define HB_OK 0

/*
 It could not be done: no board, a refusal, a file that is wrong.
 */
#define HB_FAILED 1

/*
 NULL, text that is not UTF-8, or a number that is not finite or out of range.
 */
#define HB_BAD_ARGUMENT 2

/*
 A defect of the library; the board was told to disarm.
 */
#define HB_BROKEN 3

/*
 No answer in time: the board or the computer was busy, or a frame was lost. The next call goes on.
 */
#define HB_UNANSWERED 4

/*
 The board was unplugged, or the connection to it ended: close it, and open it again once it is back.
 */
#define HB_LOST 5

/*
 hb_state.done: what was done with a request (docs/host-force.md). It acts.
 */
#define HB_TAKEN 0

/*
 hold and fade 0: it only asked.
 */
#define HB_LOOKED 1

/*
 The motors are off.
 */
#define HB_NOT_ARMED 2

/*
 A request with this number or a later one acts.
 */
#define HB_NOT_NEWER 3

/*
 More time than hold and fade since the last call.
 */
#define HB_TOO_OLD 4

/*
 A number that cannot be used: hb_error() says which.
 */
#define HB_BAD 5

/*
 hb_state.state: the motors are off.
 */
#define HB_DISARMED 0

/*
 They are on.
 */
#define HB_ARMED 1

/*
 They are on, a little, one after the other.
 */
#define HB_CHECKING_POLARITY 2

/*
 They are off until hb_clear(): hb_state.fault and hb_error() say why.
 */
#define HB_FAULT 3

/*
 A board that this program holds.
 */
typedef struct hb_board hb_board;

/*
 What the motors are asked for, in the place of what was asked for before. All zeros only asks how the device is.
 */
typedef struct {
  /*
   For how long it acts in full, 0 to 0.2.
   */
  float hold_s;
  /*
   In how long it then fades to nothing, 0 to 0.2.
   */
  float fade_s;
  /*
   At the tip.
   */
  float force_n[3];
  /*
   At the joints.
   */
  float torque_nm[3];
  /*
   1: the board renders the plane below; 0: none.
   */
  int32_t has_contact;
  /*
   A point of it.
   */
  float point_m[3];
  /*
   Its unit normal, out of the solid.
   */
  float normal[3];
  /*
   Its stiffness.
   */
  float stiffness_n_m;
  /*
   Its damping.
   */
  float damping_ns_m;
} hb_request;

/*
 How the device is.
 */
typedef struct {
  /*
   HB_TAKEN or why not.
   */
  int32_t done;
  /*
   HB_DISARMED and so on.
   */
  int32_t state;
  /*
   Control steps since boot, wrapping.
   */
  uint32_t step;
  /*
   From step to step.
   */
  float period_s;
  /*
   Of the state that the acting request was computed from; negative when none acts.
   */
  float age_s;
  /*
   Of what is asked for that acts.
   */
  float share;
  /*
   Where the tip is.
   */
  float tip_m[3];
  /*
   How fast it is.
   */
  float velocity_m_s[3];
  /*
   Joint angles.
   */
  float q_rad[3];
  /*
   Commanded, after all limits.
   */
  float torque_nm[3];
  /*
   That the host's force and contact have really added at the tip.
   */
  float force_n[3];
  /*
   Joint velocities.
   */
  float qd_rad_s[3];
  /*
   Code of the fault that is latched, see hb_fault_text(); 0 without one.
   */
  int32_t fault;
} hb_state;

#ifdef __cplusplus
extern "C" {
#endif // __cplusplus

/*
 HB_VERSION of the library.
 */
uint32_t hb_version(void);

/*
 What went wrong in the last call of this thread that failed; after hb_exchange() also which number of a request was
 HB_BAD, or which fault is latched. Never NULL; the same pointer for as long as the thread lives.
 */
const char *hb_error(void);

/*
 What a fault means and what to do about it, of its code in hb_state.fault. Valid for ever; empty for what is no code.
 */
const char *hb_fault_text(int32_t fault);

/*
 Opens a board: a serial port or serial number, tcp:HOST:PORT, sim, sim:DEVICE.toml, or NULL for the only one
 connected. NULL when it cannot be opened.
 */
hb_board *hb_open(const char *port);

/*
 Disarms the board and lets go of it. NULL is allowed.
 */
void hb_close(hb_board *board);

/*
 Loads a device file and a scene file; a NULL scene is free space. Motors must be off. Homing is forgotten. The polarity
 check still counts where the same device is loaded again and then homed near where it was homed before.
 */
int32_t hb_load(const hb_board *board, const char *device_file, const char *scene_file);

/*
 Loads a scene file for the device that the board has, which stays homed; NULL is free space. Motors must be off.
 */
int32_t hb_set_scene(const hb_board *board, const char *scene_file);

/*
 The device stands in its home pose.
 */
int32_t hb_home(const hb_board *board);

/*
 Checks that every motor turns its joint the way its encoder counts, which moves each joint a little; returns when
 that is known, HB_OK only where all of them do.
 */
int32_t hb_check_polarity(const hb_board *board);

/*
 Motors on; torque ramps up over half a second. hb_exchange(), also with NULL, must then be called at least as often as
 the board's rules ask for a sign of the host: every half second, unless they say otherwise.
 */
int32_t hb_arm(const hb_board *board);

/*
 Motors off.
 */
int32_t hb_disarm(const hb_board *board);

/*
 Clears a latched fault.
 */
int32_t hb_clear(const hb_board *board);

/*
 For how long hb_exchange() waits for its answer, s. Unless this says otherwise it waits for 0.1 and asks again, for a
 second in all. A program whose loop has less time asks for less: a lost frame then costs it no more.
 */
int32_t hb_wait_for_forces(const hb_board *board, double seconds);

/*
 Sends a request (NULL only asks) and waits for the answer, usually below a millisecond. Where none comes it returns
 HB_UNANSWERED, see hb_wait_for_forces(), and the next request goes on. A request that was not taken is no failure:
 hb_state.done says why. Allocates no memory after the first calls, unless it has words for hb_error().
 */
int32_t hb_exchange(const hb_board *board, const hb_request *request, hb_state *state);

#ifdef __cplusplus
}  // extern "C"
#endif  // __cplusplus

#endif  /* HAPTICBRIDGE_H */
