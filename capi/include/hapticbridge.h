/* haptic-bridge boards for programs in C: libhapticbridge.
 *
 * Functions that can fail return HB_OK or another code; hb_error() then says what went wrong, in words. Every function may
 * be called from any thread; calls on one board wait for each other. SI units; vectors are in the task frame or one entry
 * a joint, with zeros in entries that the device does not have. */
#ifndef HAPTICBRIDGE_H
#define HAPTICBRIDGE_H

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* Of this header. A library of another number has other structures: compare with hb_version(). */
#define HB_VERSION 1

/* What a function returns. */
#define HB_OK 0
#define HB_FAILED 1       /* it could not be done: no board, a refusal, a file that is wrong */
#define HB_BAD_ARGUMENT 2 /* NULL, or text that is not UTF-8 */
#define HB_BROKEN 3       /* a defect of the library; the board was told to disarm */

/* hb_state.done: what was done with a request (docs/host-force.md). */
#define HB_TAKEN 0
#define HB_LOOKED 1    /* hold and fade 0: it only asked */
#define HB_NOT_ARMED 2
#define HB_NOT_NEWER 3
#define HB_TOO_OLD 4   /* more time than hold and fade since the last call */
#define HB_BAD 5       /* a number that cannot be used */

/* hb_state.state */
#define HB_DISARMED 0
#define HB_ARMED 1
#define HB_CHECKING_POLARITY 2
#define HB_FAULT 3

/* A board that this program holds. */
typedef struct hb_board hb_board;

/* What the motors are asked for, in the place of what was asked for before. All zeros only asks how the device is. */
typedef struct {
    float hold_s;           /* for how long it acts in full, 0 to 0.2 */
    float fade_s;           /* in how long it then fades to nothing, 0 to 0.2 */
    float force_n[3];       /* at the tip */
    float torque_nm[3];     /* at the joints */
    int32_t has_contact;    /* 1: the board renders the plane below; 0: none */
    float point_m[3];       /* a point of it */
    float normal[3];        /* its unit normal, out of the solid */
    float stiffness_n_m;
    float damping_ns_m;
} hb_request;

/* How the device is. */
typedef struct {
    int32_t done;           /* HB_TAKEN or why not */
    int32_t state;          /* HB_DISARMED, ... */
    uint32_t step;          /* control steps since boot, wrapping */
    float period_s;         /* from step to step */
    float age_s;            /* of the state that the acting request was computed from; negative when none acts */
    float share;            /* of what is asked for that acts */
    float tip_m[3];
    float velocity_m_s[3];
    float q_rad[3];
    float torque_nm[3];     /* commanded, after all limits */
    float force_n[3];       /* that the host's force and contact have really added at the tip */
} hb_state;

/* HB_VERSION of the library. */
uint32_t hb_version(void);

/* What went wrong in the last call of this thread that failed; valid until its next call. Never NULL. */
const char *hb_error(void);

/* Opens a board: a serial port or serial number, tcp:HOST:PORT, sim, sim:DEVICE.toml, or NULL for the only one
 * connected. NULL when it cannot be opened. */
hb_board *hb_open(const char *port);

/* Disarms the board and lets go of it. NULL is allowed. */
void hb_close(hb_board *board);

/* Loads a device file and a scene file; a NULL scene is free space. Motors must be off. */
int32_t hb_load(hb_board *board, const char *device_file, const char *scene_file);

/* The device stands in its home pose. */
int32_t hb_home(hb_board *board);

/* Starts the polarity check, which moves each joint a little. */
int32_t hb_check_polarity(hb_board *board);

/* Motors on; torque ramps up over half a second. hb_exchange must then be called at least as often as the board's rules
 * ask for a sign of the host. */
int32_t hb_arm(hb_board *board);

/* Motors off. */
int32_t hb_disarm(hb_board *board);

/* Clears a latched fault. */
int32_t hb_clear(hb_board *board);

/* Sends a request (NULL only asks) and waits for the answer, well below a millisecond. A request that was not taken is
 * no failure: hb_state.done says why. */
int32_t hb_exchange(hb_board *board, const hb_request *request, hb_state *state);

#ifdef __cplusplus
}
#endif
#endif
