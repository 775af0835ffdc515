/* Uses libhdPhantom.so like CHAI3D 3.3 (src/devices/CPhantomDevices.cpp): the same libraries, symbols and order of calls, and a
 * loop like its haptics thread with a sphere that pushes the tip out. */
#include <dlfcn.h>
#include <math.h>
#include <stdio.h>
#include <string.h>
#include <time.h>

static int (*GetNumDevices)(void);
static int (*Open)(const int);
static int (*Close)(const int);
static int (*GetPosition)(const int, double *, double *, double *);
static int (*GetLinearVelocity)(const int, double *, double *, double *);
static int (*GetRotation)(const int, double *, double *, double *, double *, double *, double *, double *, double *, double *);
static int (*GetButtons)(const int);
static int (*SetForce)(const int, const double *, const double *, const double *);
static int (*SetTorque)(const int, const double *, const double *, const double *);
static int (*SetForceAndTorque)(const int, const double *, const double *, const double *, const double *, const double *,
                                const double *);
static int (*GetWorkspaceRadius)(const int, double *);
static int (*GetType)(const int, char *);
static void (*StartServo)(void);
static void (*StopServo)(void);

static int missing;
static void look_up(void *library, const char *name, void *into) {
    void *found = dlsym(library, name);
    if (!found) {
        fprintf(stderr, "no %s\n", name);
        missing = 1;
    }
    memcpy(into, &found, sizeof found);
}

static double now(void) {
    struct timespec time;
    clock_gettime(CLOCK_MONOTONIC, &time);
    return time.tv_sec + 1e-9 * time.tv_nsec;
}

int main(void) {
    if (!dlopen("libHD.so", RTLD_LAZY | RTLD_GLOBAL)) return fprintf(stderr, "%s\n", dlerror()), 2;
    void *library = dlopen("libhdPhantom.so", RTLD_LAZY | RTLD_GLOBAL);
    if (!library) return fprintf(stderr, "%s\n", dlerror()), 2;
    look_up(library, "hdPhantomGetNumDevices", &GetNumDevices);
    look_up(library, "hdPhantomOpen", &Open);
    look_up(library, "hdPhantomClose", &Close);
    look_up(library, "hdPhantomGetPosition", &GetPosition);
    look_up(library, "hdPhantomGetLinearVelocity", &GetLinearVelocity);
    look_up(library, "hdPhantomGetRotation", &GetRotation);
    look_up(library, "hdPhantomGetButtons", &GetButtons);
    look_up(library, "hdPhantomSetForce", &SetForce);
    look_up(library, "hdPhantomSetTorque", &SetTorque);
    look_up(library, "hdPhantomSetForceAndTorque", &SetForceAndTorque);
    look_up(library, "hdPhantomGetWorkspaceRadius", &GetWorkspaceRadius);
    look_up(library, "hdPhantomGetType", &GetType);
    look_up(library, "hdPhantomStartServo", &StartServo);
    look_up(library, "hdPhantomStopServo", &StopServo);
    if (missing) return 2;

    /* cHapticDeviceHandler counts the devices, and cPhantomDevice's constructor reads the type before it opens the device. */
    char name[255];
    double radius, turned[9];
    if (GetNumDevices() != 1 || GetWorkspaceRadius(0, &radius) || GetType(0, name)) return 3;
    if (Open(0)) return 4;
    /* The sphere's middle is 10 mm beside the tip's start, and its surface another 10 mm beyond. A damped force of 0.3 N pulls
     * the tip to the middle. */
    const double middle[3] = {-0.006, 0.008, 0.0}, sphere = 0.02, stiffness = 300.0, damping = 8.0, pull = 0.3;
    const int ticks = 1500;
    const double began = now();
    double at[3], speed[3], torque[3] = {0, 0, 0}, first = -1, away = 0;
    for (int tick = 0; tick < ticks; tick++) {
        if (GetPosition(0, &at[0], &at[1], &at[2]) || GetLinearVelocity(0, &speed[0], &speed[1], &speed[2])) return 5;
        if (GetRotation(0, &turned[0], &turned[1], &turned[2], &turned[3], &turned[4], &turned[5], &turned[6], &turned[7],
                        &turned[8]))
            return 5;
        double out[3], force[3] = {0, 0, 0};
        away = 0;
        for (int i = 0; i < 3; i++) away += (at[i] - middle[i]) * (at[i] - middle[i]);
        away = sqrt(away);
        if (first < 0) first = away;
        for (int i = 0; i < 3; i++) out[i] = (at[i] - middle[i]) / away;
        const double push = away < sphere ? stiffness * (sphere - away) : 0.0;
        for (int i = 0; i < 3; i++) force[i] = (push - pull) * out[i] - damping * speed[i];
        if (SetForceAndTorque(0, &force[0], &force[1], &force[2], &torque[0], &torque[1], &torque[2])) return 6;
    }
    const double took = now() - began;
    printf("%s|%g|%g|%g|%g %g %g|%g|%d\n", name, radius, first, away, at[0], at[1], at[2], took, GetButtons(0));
    /* There is no other device, and NULL is an error. */
    if (Open(1) != -1 || GetPosition(1, &at[0], &at[1], &at[2]) != -1 || GetPosition(0, NULL, NULL, NULL) != -1) return 7;
    if (SetForce(0, NULL, NULL, NULL) != -1 || SetTorque(0, &torque[0], &torque[1], &torque[2])) return 7;
    StartServo();
    if (Close(0)) return 8;
    StopServo();
    return 0;
}
