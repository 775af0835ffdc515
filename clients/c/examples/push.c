/* Pushes a tip sideways against a spring that this program computes: push PORT DEVICE.toml
 *
 *     gcc push.c $(pkg-config --cflags --libs hapticbridge) -lm -o push
 */
#include <hapticbridge.h>
#include <math.h>
#include <stddef.h>
#include <stdio.h>

static int failed(const char *what) {
    fprintf(stderr, "%s: %s\n", what, hb_error());
    return 1;
}

int main(int count, char **arguments) {
    if (count != 3 || hb_version() != HB_VERSION) {
        fprintf(stderr, "usage: push PORT DEVICE.toml, with a library of version %d\n", HB_VERSION);
        return 2;
    }
    hb_board *board = hb_open(arguments[1]);
    if (!board) return failed("open");
    hb_state state;
    if (hb_load(board, arguments[2], NULL) || hb_arm(board) || hb_exchange(board, NULL, &state)) {
        hb_close(board);
        return failed("start");
    }
    const float from[2] = {state.tip_m[0], state.tip_m[1]};
    const uint32_t began = state.step;
    /* The torque ramps up for 0.5 s, then the tip comes to rest within 0.5 s. */
    while ((float)(state.step - began) * state.period_s < 1.0f) {
        hb_request request = {.hold_s = 0.02f, .fade_s = 0.05f};
        request.force_n[0] = 0.5f - 100.0f * (state.tip_m[0] - from[0]) - 2.0f * state.velocity_m_s[0];
        request.force_n[1] = -100.0f * (state.tip_m[1] - from[1]) - 2.0f * state.velocity_m_s[1];
        if (hb_exchange(board, &request, &state)) {
            hb_close(board);
            return failed("push");
        }
    }
    const double moved[2] = {(double)(state.tip_m[0] - from[0]), (double)(state.tip_m[1] - from[1])};
    printf("moved %.5f %.5f done %d state %d\n", moved[0], moved[1], state.done, state.state);
    /* A test compares these numbers with the library's. */
    printf("sizes %zu %zu offsets %zu %zu\n", sizeof(hb_request), sizeof(hb_state), offsetof(hb_request, damping_ns_m),
           offsetof(hb_state, fault));
    hb_close(board);
    /* A port that cannot be opened has an error message. */
    if (hb_open("tcp:127.0.0.1:1")) return 1;
    printf("%s\n", hb_error());
    return 0;
}
