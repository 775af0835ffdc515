// Equations of motion and equation (4) of the shipped devices with Pinocchio, for `cargo xtask dynamics`. Reads the
// output of the benchmark `dynamics --states` from standard input. Exits with an error if a result differs; otherwise
// prints the time for one state, ns, in rows with the benchmark's names:
//
// "M, b, J": mass matrix, Coriolis and gravity torques, and Jacobian of the tip, in the angles of the driven joints.
// "(4)": in addition J̇q̇, the basis of the wall, W, z, Weff, f_a and the torques with and without the feed-forward.
//
// The code uses Pinocchio's fast functions: crba in world coordinates, which also computes the joints' Jacobian, and
// nonLinearEffects, whose accelerations give J̇q̇ without J̇. Matrices have fixed sizes. Pinocchio models a closed loop
// as a tree, so this program computes the passive joints' angles and v = S q̇, M = Sᵀ M S, b = Sᵀ (b + M Ṡq̇).
#include <pinocchio/multibody.hpp>

#include <pinocchio/algorithm/crba.hpp>
#include <pinocchio/algorithm/rnea.hpp>

#include <Eigen/Dense>
#include <algorithm>
#include <chrono>
#include <cmath>
#include <iostream>
#include <string>
#include <vector>

namespace pin = pinocchio;
using Eigen::Vector2d;
using Eigen::Vector3d;
template <int N> using Vector = Eigen::Matrix<double, N, 1>;
template <int N> using Square = Eigen::Matrix<double, N, N>;

constexpr int PASSES = 101;  // Number of timed passes, as in dynamics.rs.
constexpr double TOLERANCE = 1e-9;  // Largest relative difference of a result.

template <int N> struct Equations {
  Square<N> M, J;
  Vector<N> b, bent;  // bent: J̇q̇
};
template <int N> struct Whole {
  Square<N> basis, W;
  Vector<N> z, torque, without, f_a;
  double w_eff;
};
template <int N> struct State {
  Vector<N> q, qd, n;
};

template <class T> inline void keep(const T& value) { asm volatile("" : : "r"(&value) : "memory"); }

// A tree of joints. The tip is at `at[0]` on link `end[0]`; in a closed loop it is also at `at[1]` on link `end[1]`.
struct Device {
  pin::Model model;
  pin::Data data;
  pin::JointIndex end[2] = {0, 0};
  Vector3d at[2];

  template <class Joint>
  pin::JointIndex add(pin::JointIndex on, const Joint& joint, const Vector3d& place, double rotor) {
    const pin::SE3 at(Eigen::Matrix3d::Identity(), place);
    const auto index = model.addJoint(on, joint, at, std::to_string(model.njoints));
    model.armature[model.nv - 1] = rotor;
    return index;
  }
  void link(pin::JointIndex on, double mass, double com, double inertia, double axial, double transverse) {
    const Vector3d moments(axial, transverse, inertia);
    model.appendBodyToJoint(on, pin::Inertia(mass, Vector3d(com, 0, 0), moments.asDiagonal()));
  }
  void tip(int k, pin::JointIndex on, double x, double mass = 0) {
    end[k] = on;
    at[k] = Vector3d(x, 0, 0);
    model.appendBodyToJoint(on, pin::Inertia(mass, at[k], Eigen::Matrix3d::Zero()));
  }
  void done(const Vector3d& gravity) {
    model.gravity.linear(gravity);
    data = pin::Data(model);
  }
  Vector3d point() const { return data.oMi[end[0]].act(at[0]); }
  Vector3d column(int joint, const Vector3d& p) const {
    const auto& j = data.J.col(joint);
    return j.head<3>() + Vector3d(j.tail<3>()).cross(p);
  }
  // Returns the acceleration of end k without joint accelerations. Adds gravity back, because data.a_gf includes it.
  Vector3d coasting(int k) const {
    const auto &v = data.v[end[k]], &a = data.a_gf[end[k]];
    const Vector3d moved = v.linear() + v.angular().cross(at[k]);
    const Vector3d local = a.linear() + a.angular().cross(at[k]) + v.angular().cross(moved);
    return data.oMi[end[k]].rotation() * local + model.gravity.linear();
  }
};

struct Serial3r : Device {
  static constexpr int N = 3, TASK = 2;
  Serial3r() {
    const Vector3d none = Vector3d::Zero();
    const auto a = add(0, pin::JointModelRZ(), none, 5e-5);
    link(a, 0.1, 0.07, 2e-4, 0, 2e-4);
    const auto b = add(a, pin::JointModelRZ(), Vector3d(0.15, 0, 0), 2e-5);
    link(b, 0.07, 0.06, 9e-5, 0, 9e-5);
    const auto c = add(b, pin::JointModelRZ(), Vector3d(0.12, 0, 0), 1e-5);
    link(c, 0.04, 0.04, 2.5e-5, 0, 2.5e-5);
    tip(0, c, 0.08, 0.03);
    done(Vector3d(0, -9.81, 0));
  }
  void equations(const State<3>& s, Equations<3>& e, bool rate) {
    pin::crba(model, data, s.q, pin::Convention::WORLD);
    pin::nonLinearEffects(model, data, s.q, s.qd);
    e.M = data.M.selfadjointView<Eigen::Upper>();
    e.b = data.nle;
    const Vector3d p = point();
    for (int i = 0; i < 3; i++) e.J.col(i) << column(i, p).head<2>(), 1;
    if (rate) e.bent << coasting(0).head<2>(), 0;
  }
};

struct Parallelogram : Device {
  static constexpr int N = 3, TASK = 3;
  Parallelogram() {
    const Vector3d none = Vector3d::Zero();
    const auto turret = add(0, pin::JointModelRY(), none, 0.001411);
    const auto upper = add(turret, pin::JointModelRZ(), none, 0.00013548);
    link(upper, 0.26784, -0.03518875, 0.00091667, 0.0001133, 0.00082222);
    const auto fore = add(upper, pin::JointModelRZ(), Vector3d(0.20955, 0, 0), 0);
    link(fore, 0.02622, 0.05237892, 6.029e-05, 5.7e-07, 6.004e-05);
    const auto crank = add(turret, pin::JointModelRZ(), none, 0.00013548);
    link(crank, 0.21542, 0.05153541, 0.00026133, 0.0001214, 0.00015823);
    const auto coupler = add(crank, pin::JointModelRZ(), Vector3d(0.03175, 0, 0), 0);
    link(coupler, 0.026146, 0.10477739, 0.00013177, 8.9e-07, 0.00013138);
    tip(0, fore, 0.169545);
    done(Vector3d(0, -9.80665, 0));
  }
  void equations(const State<3>& s, Equations<3>& e, bool rate) {
    Vector<5> q, v;
    q << s.q[0], s.q[1], s.q[2] - s.q[1], s.q[2] + M_PI, s.q[1] - s.q[2] - M_PI;
    v << s.qd[0], s.qd[1], s.qd[2] - s.qd[1], s.qd[2], s.qd[1] - s.qd[2];
    pin::crba(model, data, q, pin::Convention::WORLD);
    pin::nonLinearEffects(model, data, q, v);
    Eigen::Matrix<double, 5, 3> S;
    S << 1, 0, 0, 0, 1, 0, 0, -1, 1, 0, 0, 1, 0, 1, -1;
    const Square<5> M = data.M.selfadjointView<Eigen::Upper>();
    e.M.noalias() = S.transpose() * (M * S).eval();
    e.b.noalias() = S.transpose() * data.nle;
    const Vector3d p = point(), fore = column(2, p);
    e.J << column(0, p), column(1, p) - fore, fore;
    if (rate) e.bent = coasting(0);
  }
};

// A five-bar on a turret with T joints, 0 or 1.
template <int T> struct FiveBar : Device {
  static constexpr int N = T + 2, TREE = T + 4, TASK = N;
  double base, near[2], far[2];

  // `links`: proximal, then distal links, each with mass, centre of mass, and inertia about z, x and y.
  FiveBar(double base, const double (&near)[2], const double (&far)[2], const double (&rotors)[2],
          const double (&links)[4][5], double turret, double handle, const Vector3d& gravity)
      : base(base), near{near[0], near[1]}, far{far[0], far[1]} {
    const auto root = T ? add(0, pin::JointModelRX(), Vector3d::Zero(), turret) : 0;
    const auto bar = [&](pin::JointIndex on, const double (&l)[5]) { link(on, l[0], l[1], l[2], l[3], l[4]); };
    for (int k = 0; k < 2; k++) {
      const auto proximal = add(root, pin::JointModelRZ(), Vector3d(k ? base / 2 : -base / 2, 0, 0), rotors[k]);
      bar(proximal, links[k]);
      const auto distal = add(proximal, pin::JointModelRZ(), Vector3d(near[k], 0, 0), 0);
      bar(distal, links[2 + k]);
      tip(k, distal, far[k], k ? 0 : handle);
    }
    done(gravity);
  }
  // Returns all joint angles for motor angles m. The tip is left of the line from the first elbow to the second.
  Vector<TREE> closed(const Vector<N>& m) const {
    double s1, c1, s2, c2;
    sincos(m[T], &s1, &c1);
    sincos(m[T + 1], &s2, &c2);
    const double ux = base + near[1] * c2 - near[0] * c1, uy = near[1] * s2 - near[0] * s1;
    const double inverse = 1 / (ux * ux + uy * uy);
    const double along = 0.5 + 0.5 * (far[0] * far[0] - far[1] * far[1]) * inverse;
    const double across = std::sqrt(std::max(0.0, far[0] * far[0] * inverse - along * along));
    const double px = along * ux - across * uy, py = along * uy + across * ux;
    Vector<TREE> q;
    if constexpr (T == 1) q[0] = m[0];
    q.template tail<4>() << m[T], std::atan2(py, px) - m[T], m[T + 1], std::atan2(py - uy, px - ux) - m[T + 1];
    return q;
  }
  void equations(const State<N>& s, Equations<N>& e, bool rate) {
    const Vector<TREE> q = closed(s.q);
    pin::crba(model, data, q, pin::Convention::WORLD);
    const Vector3d p = point();
    const Vector3d a1 = column(T, p), b1 = column(T + 1, p), a2 = column(T + 2, p), b2 = column(T + 3, p);
    // Both arms move the tip with the same velocity in the plane: a₁ q̇₁ + b₁ ḋ₁ = a₂ q̇₂ + b₂ ḋ₂.
    const Eigen::Matrix<double, 2, 3> plane = data.oMi[end[0]].rotation().template leftCols<2>().transpose();
    Square<2> loop;
    loop << plane * b1, -(plane * b2);
    const Square<2> inverse = loop.inverse();
    const Vector2d d1 = -(inverse * (plane * a1)), d2 = inverse * (plane * a2);
    Eigen::Matrix<double, TREE, N> S = Eigen::Matrix<double, TREE, N>::Zero();
    if constexpr (T == 1) S(0, 0) = 1;
    S.template bottomRightCorner<4, 2>() << 1, 0, d1[0], d2[0], 0, 1, d1[1], d2[1];
    const Vector<TREE> v = S * s.qd;
    pin::nonLinearEffects(model, data, q, v);
    const Square<TREE> M = data.M.template selfadjointView<Eigen::Upper>();
    e.M.noalias() = S.transpose() * (M * S).eval();
    const Vector3d f1 = coasting(0), f2 = coasting(1);
    const Vector2d dd = inverse * (plane * (f2 - f1));
    e.b.noalias() = S.transpose() * (data.nle + M.col(T + 1) * dd[0] + M.col(T + 3) * dd[1]).eval();
    if constexpr (T == 1) e.J.col(0) = column(0, p);
    e.J.col(T) = (a1 + b1 * d1[0]).template head<N>();
    e.J.col(T + 1) = (b1 * d2[0]).template head<N>();
    if (rate) e.bent = (f1 + b1 * dd[0]).template head<N>();
  }
};

// Returns the library's basis: the wall's normal, the directions across the normal, then the orientation φ.
template <int N> Square<N> basis_of(const Vector<N>& n, int task) {
  Square<N> basis = Square<N>::Identity();
  basis.col(0) = n;
  if (task == 2) {
    basis(0, 1) = -n[1];
    basis(1, 1) = n[0];
  } else if constexpr (N == 3) {
    int least = 0;
    for (int i = 1; i < 3; i++)
      if (std::abs(n[i]) < std::abs(n[least])) least = i;
    basis.col(1) = (Vector3d::Unit(least) - n * n[least]).normalized();
    basis.col(2) = n.cross(Vector3d(basis.col(1)));
  }
  return basis;
}

// Computes equation (4) for a wall that pushes with 1 N.
template <int N> void equation4(const Equations<N>& e, const Vector<N>& n, int task, Whole<N>& out) {
  out.basis = basis_of<N>(n, task);
  const Square<N> inverse = e.J.inverse(), E = inverse * out.basis, ME = e.M * E;
  out.W.noalias() = E.transpose() * ME;
  const Vector<N> b = e.b - e.M * (inverse * e.bent);
  out.z.noalias() = E.transpose() * b;
  const Vector<N> row = e.J.transpose() * out.basis.col(0);
  out.w_eff = 1 / row.dot(e.M.ldlt().solve(row));
  out.without = row;
  out.torque = ME.col(0) * ((1 - out.z[0]) / out.W(0, 0)) + b;
  out.f_a.setZero();
  out.f_a.template head<N - 1>() = (E.transpose() * out.torque).template tail<N - 1>();
}

template <class T> void read(T&& values) {
  for (int j = 0; j < values.cols(); j++)
    for (int i = 0; i < values.rows(); i++) std::cin >> values(i, j);
}

// Returns the largest difference of entries relative to the largest entry, or to 1e-3 if all entries are almost zero.
template <class A> double apart(const A& a, const A& b) {
  return (a - b).cwiseAbs().maxCoeff() / std::max(b.cwiseAbs().maxCoeff(), 1e-3);
}

template <class Pass> void time(const std::string& name, const char* row, size_t states, Pass&& pass) {
  double fastest = INFINITY;
  for (int i = 0; i < PASSES; i++) {
    const auto start = std::chrono::steady_clock::now();
    pass();
    const std::chrono::duration<double, std::nano> taken = std::chrono::steady_clock::now() - start;
    fastest = std::min(fastest, taken.count());
  }
  std::cout << name << ' ' << fastest / states << ' ' << row << std::endl;
}

template <class D> void run(const std::string& name, size_t count, D device) {
  constexpr int N = D::N;
  std::vector<State<N>> states(count);
  Equations<N> e, its_e;  // `its_` marks the library's results.
  Whole<N> w, its_w;
  double worst = 0;
  for (auto& s : states) {
    read(s.q), read(s.qd), read(s.n);
    read(its_e.b), read(its_w.z), read(its_w.torque), read(its_w.without), read(its_w.f_a);
    read(its_e.M), read(its_e.J), read(its_w.W);
    std::cin >> its_w.w_eff;
    device.equations(s, e, true);
    equation4<N>(e, s.n, D::TASK, w);
    worst = std::max({worst, apart(e.M, its_e.M), apart(e.b, its_e.b), apart(e.J, its_e.J), apart(w.W, its_w.W)});
    worst = std::max({worst, apart(w.z, its_w.z), apart(w.torque, its_w.torque), apart(w.without, its_w.without)});
    worst = std::max({worst, apart(w.f_a, its_w.f_a), std::abs(w.w_eff / its_w.w_eff - 1)});
  }
  if (!(worst < TOLERANCE)) {
    std::cerr << name << ": Pinocchio and the library differ by " << worst << std::endl;
    std::exit(1);
  }
  time(name, "M, b, J", states.size(), [&] {
    for (const auto& s : states) keep(s), device.equations(s, e, false), keep(e);
  });
  time(name, "(4)", states.size(), [&] {
    for (const auto& s : states) {
      keep(s);
      device.equations(s, e, true);
      equation4<N>(e, s.n, D::TASK, w);
      keep(w);
    }
  });
}

int main() {
  std::string name, rest;
  for (size_t count; std::cin >> name >> count;) {
    if (name == "five-bar") {
      run(name, count, FiveBar<0>(0.038, {0.07, 0.07}, {0.09, 0.09}, {1.4e-6, 1.4e-6},
          {{0.018, 0.03, 9e-6, 0, 9e-6}, {0.018, 0.03, 9e-6, 0, 9e-6},
           {0.012, 0.045, 9e-6, 0, 9e-6}, {0.012, 0.045, 9e-6, 0, 9e-6}},
          0, 0.02, Vector3d::Zero()));
    } else if (name == "five-bar-turret") {
      run(name, count, FiveBar<1>(0.04, {0.09, 0.085}, {0.12, 0.125}, {8e-5, 7e-5},
          {{0.04, 0.035, 3e-5, 3e-6, 2.8e-5}, {0.038, 0.034, 2.7e-5, 2.8e-6, 2.5e-5},
           {0.03, 0.06, 4e-5, 1.5e-6, 3.9e-5}, {0.031, 0.062, 4.3e-5, 1.5e-6, 4.2e-5}},
          4e-4, 0.03, Vector3d(0, 0, -9.81)));
    } else if (name == "parallelogram") {
      run(name, count, Parallelogram());
    } else if (name == "serial-3r") {
      run(name, count, Serial3r());
    } else {  // Skip the paddle, which has only one joint.
      std::getline(std::cin, rest);
      while (count--) std::getline(std::cin, rest);
    }
  }
}
