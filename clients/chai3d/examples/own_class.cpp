// Uses CHAI3D's own class for these devices, from its unchanged sources, with a sphere (docs/chai3d.md: build).
#include "system/CGlobals.h"

#include "devices/CPhantomDevices.h"
#include <cstdio>

using namespace chai3d;
int main() {
    printf("devices: %u\n", cPhantomDevice::getNumDevices());
    cGenericHapticDevicePtr device = cPhantomDevice::create(0);
    cHapticDeviceInfo info = device->getSpecifications();
    printf("%s: %g N, %g N/m, radius %g m\n", info.m_modelName.c_str(), info.m_maxLinearForce, info.m_maxLinearStiffness, info.m_workspaceRadius);
    if (!device->open() || !device->calibrate()) return 1;
    // A sphere that pushes outwards, 0.3 N towards its middle, and viscous damping.
    cVector3d middle(0.0, 0.01, 0.0), position, velocity, force;
    cPrecisionClock clock; clock.start(true);
    for (int tick = 0; tick < 2000; tick++) {
        device->getPosition(position);
        device->getLinearVelocity(velocity);
        cVector3d out = position - middle; double away = out.length(); out.normalize();
        force = (-0.3 + (away < 0.02 ? 300.0 * (0.02 - away) : 0.0)) * out - 8.0 * velocity;
        if (!device->setForce(force)) return 2;
        if (tick % 400 == 399) printf("tick %d: %s m, %.4f m from the middle, %.3f s\n", tick + 1, position.str(4).c_str(), away, clock.getCurrentTimeSeconds());
    }
    device->close();
    return 0;
}
