// Elements of sheets: triangles that stretch and hinges that bend, with damping by the rates of both (Kelvin-Voigt).
//
// Both are quadratic in a strain e(x), with stiffness K and damping B, over the time tau of a rate:
//
//     E = 1/2 e^T K e + 1/(2 tau) (e - e_b)^T B (e - e_b),    e_b = now e(x_start) + before e(x_past)
//     dE/dx = L^T s,   s = K e + B (e - e_b) / tau,   L = de/dx,    d2E/dx2 = L^T (K + B / tau) L + s . d2e/dx2
//
// Of triangles e is the Green strain, K = A h C and B = beta K (sim_core/energies/membrane.py); of hinges the change of
// all angles from rest, and K = sum_T A_T B_T^T D_T B_T with the curvature operator B_T, which couples them
// (sim_core/energies/curvature.py). An element adds its force, its Hessian, and, for derivatives by parameters p, what
// its force changes by where positions at the end are held:
//
//     L^T [dK/dp e + dB/dp (e - e_b) / tau - B de_b/dp / tau]
#pragma once

#include <limits>
#include <vector>

#include "blocks.hpp"
#include "laws.hpp"
#include "pack.hpp"
#include "record.hpp"

namespace thinshell {

using Vec3 = Vec<double, 3>;
using Mat3 = Mat<double, 3, 3>;

inline Vec3 point(const double *x, int i) { return {{x[3 * i], x[3 * i + 1], x[3 * i + 2]}}; }
inline void add(double *x, int i, const Vec3 &v) {
  for (int k = 0; k < 3; ++k) x[3 * i + k] += v[k];
}

// From what rates are measured: weights of the start of the step and of that before it, and the time.
struct Rates {
  double now, before, tau;
};

class Triangles {
 public:
  explicit Triangles(const Record &record) : r_(record), count_(int(record.triangles)), base_(3 * record.triangles) {
    for (int t = 0; t < count_; ++t) damped_ = damped_ || r_.stretch_damping[t] != 0.0;
    for (int k = 0; k < r_.stretch_blocks; ++k)
      for (int t = 0; t < count_; ++t) damped_ = damped_ || r_.d_stretch_damping[std::size_t(k) * count_ + t] != 0.0;
    slope_now_.assign(damped_ ? 3 * r_.triangles * r_.columns : 0, 0.0);
    slope_past_ = slope_now_;
  }

  void couple(Blocks &h) const {
    for (int t = 0; t < count_; ++t)
      for (int a = 0; a < 3; ++a)
        for (int d = a; d < 3; ++d) h.couple(node(t, a), node(t, d));
  }
  void bind(const Blocks &h) {
    slots_.clear();
    for (int t = 0; t < count_; ++t)
      for (int a = 0; a < 3; ++a)
        for (int d = a; d < 3; ++d) slots_.push_back(h.slot(node(t, a), node(t, d)));
  }

  void begin(const double *x_start, const double *x_past, const Rates &rates) {
    rates_ = rates;
    if (!damped_) return;
    for (int t = 0; t < count_; ++t) {
      Vec3 base = rates.now * strain(columns_of(x_start, t));
      if (x_past) base += rates.before * strain(columns_of(x_past, t));
      for (int i = 0; i < 3; ++i) base_[3 * t + i] = base[i];
    }
  }

  double energy(const double *x) const {
    double out = 0.0;
    for (int t = 0; t < count_; ++t) {
      const Vec3 e = strain(columns_of(x, t));
      out += 0.5 * e.dot(stiff(t, e));
      if (damped_) {
        const Vec3 since = e - base(t);
        out += 0.5 * rate(t) * since.dot(stiff(t, since));
      }
    }
    return out;
  }

  void add_gradient(const double *x, double *out) const {
    for (int t = 0; t < count_; ++t) {
      const Mat<double, 3, 2> f = columns_of(x, t);
      const Vec3 s = stress(t, strain(f));
      const double *b = r_.hats + 6 * t;
      for (int a = 0; a < 3; ++a)
        for (int i = 0; i < 3; ++i)
          out[3 * node(t, a) + i] += f(i, 0) * (s[0] * b[2 * a] + s[2] * b[2 * a + 1]) +
                                     f(i, 1) * (s[2] * b[2 * a] + s[1] * b[2 * a + 1]);
    }
  }

  // `move`: by whose linear part the stress is foreseen (null: that of the positions). Without `exact` semidefinite.
  void add_hessian(const double *x, const double *move, bool exact, Blocks &h) const {
    for (int t = 0; t < count_; ++t) {
      const Mat<double, 3, 2> f = columns_of(x, t);
      Vec3 e = strain(f);
      if (move) {
        const Mat<double, 3, 2> d = columns_of(move, t);
        for (int i = 0; i < 3; ++i) {
          e[0] -= 0.5 * d(i, 0) * d(i, 0);
          e[1] -= 0.5 * d(i, 1) * d(i, 1);
          e[2] -= d(i, 0) * d(i, 1);
        }
      }
      Vec3 s = stress(t, e);
      if (!exact) s = laws::membrane::tension_of(s);
      const double scale = 1.0 + rate(t), *k = r_.stretch_stiffness + 9 * t, *b = r_.hats + 6 * t;
      const Slot *slot = &slots_[6 * t];
      for (int a = 0; a < 3; ++a) {
        double left[2][3];
        for (int j = 0; j < 3; ++j) {
          left[0][j] = scale * (b[2 * a] * k[j] + b[2 * a + 1] * k[6 + j]);
          left[1][j] = scale * (b[2 * a + 1] * k[3 + j] + b[2 * a] * k[6 + j]);
        }
        for (int d = a; d < 3; ++d, ++slot) {
          const double p = b[2 * d], q = b[2 * d + 1];
          const double geometric = s[0] * b[2 * a] * p + s[1] * b[2 * a + 1] * q + s[2] * (b[2 * a] * q + b[2 * a + 1] * p);
          double w[2][2];
          for (int m = 0; m < 2; ++m) {
            w[m][0] = left[m][0] * p + left[m][2] * q;
            w[m][1] = left[m][1] * q + left[m][2] * p;
          }
          Mat3 block;
          for (int i = 0; i < 3; ++i)
            for (int j = 0; j < 3; ++j)
              block(i, j) = f(i, 0) * (w[0][0] * f(j, 0) + w[0][1] * f(j, 1)) +
                            f(i, 1) * (w[1][0] * f(j, 0) + w[1][1] * f(j, 1)) + (i == j ? geometric : 0.0);
          h.add(*slot, block);
        }
      }
    }
  }

  // Derivatives of the strains at the end of a step, from those of the positions (nodes, 3, columns).
  void keep_slopes(const double *x, const double *dx) {
    if (!damped_) return;
    slope_past_.swap(slope_now_);
    measure_slopes(x, dx, slope_now_);
  }
  // A state without the one before it.
  void restart_slopes(const double *x, const double *dx) {
    if (damped_) measure_slopes(x, dx, slope_now_);
  }

  // What forces change by at held positions, into (nodes, 3, columns).
  void add_columns(const double *x, double *out) const {
    const int width = int(r_.columns);
    if (!damped_ && !r_.stretch_blocks) return;
    std::vector<double> change(3 * width);
    for (int t = 0; t < count_; ++t) {
      const Mat<double, 3, 2> f = columns_of(x, t);
      const Vec3 e = strain(f), since = damped_ ? Vec3(e - base(t)) : Vec3{};
      const double *k = r_.stretch_stiffness + 9 * t;
      std::fill(change.begin(), change.end(), 0.0);
      if (damped_ && rate(t) != 0.0) {
        const double *now = &slope_now_[std::size_t(3 * t) * width], *past = &slope_past_[std::size_t(3 * t) * width];
        for (int i = 0; i < 3; ++i)
          for (int j = 0; j < 3; ++j) {
            const double by = -rate(t) * k[3 * i + j];
            for (int c = 0; c < width; ++c)
              change[i * width + c] += by * (rates_.now * now[j * width + c] + rates_.before * past[j * width + c]);
          }
      }
      for (int m = 0; m < r_.stretch_blocks; ++m) {
        const double *dk = r_.d_stretch_stiffness + (std::size_t(m) * count_ + t) * 9;
        const double more = r_.d_stretch_damping[std::size_t(m) * count_ + t] / rates_.tau;
        const Vec3 whole = e + rate(t) * since;
        for (int i = 0; i < 3; ++i) {
          double total = 0.0;
          for (int j = 0; j < 3; ++j) total += dk[3 * i + j] * whole[j] + more * k[3 * i + j] * since[j];
          change[i * width + r_.stretch_of[m]] += total;
        }
      }
      const double *b = r_.hats + 6 * t;
      for (int a = 0; a < 3; ++a)
        for (int i = 0; i < 3; ++i) {
          const double u = f(i, 0) * b[2 * a], v = f(i, 1) * b[2 * a + 1];
          const double w = f(i, 0) * b[2 * a + 1] + f(i, 1) * b[2 * a];
          double *to = out + (3 * std::size_t(node(t, a)) + i) * width;
          for (int c = 0; c < width; ++c) to[c] += u * change[c] + v * change[width + c] + w * change[2 * width + c];
        }
    }
  }

  std::vector<double> &slope_now() { return slope_now_; }
  std::vector<double> &slope_past() { return slope_past_; }

 private:
  int node(int t, int a) const { return r_.triangle[3 * t + a]; }
  double rate(int t) const { return r_.stretch_damping[t] / rates_.tau; }
  Vec3 base(int t) const { return point(base_.data(), t); }

  // The two columns of the deformation gradient.
  Mat<double, 3, 2> columns_of(const double *x, int t) const {
    const double *b = r_.hats + 6 * t;
    Mat<double, 3, 2> f{};
    for (int a = 0; a < 3; ++a)
      for (int i = 0; i < 3; ++i)
        for (int j = 0; j < 2; ++j) f(i, j) += x[3 * node(t, a) + i] * b[2 * a + j];
    return f;
  }
  static Vec3 strain(const Mat<double, 3, 2> &f) {
    return laws::membrane::green_strain(Vec3{{f(0, 0), f(1, 0), f(2, 0)}}, Vec3{{f(0, 1), f(1, 1), f(2, 1)}});
  }
  Vec3 stiff(int t, const Vec3 &e) const {
    const double *k = r_.stretch_stiffness + 9 * t;
    Vec3 out;
    for (int i = 0; i < 3; ++i) out[i] = k[3 * i] * e[0] + k[3 * i + 1] * e[1] + k[3 * i + 2] * e[2];
    return out;
  }
  Vec3 stress(int t, const Vec3 &e) const {
    return damped_ ? stiff(t, Vec3((1.0 + rate(t)) * e - rate(t) * base(t))) : stiff(t, e);
  }

  void measure_slopes(const double *x, const double *dx, std::vector<double> &out) const {
    const int width = int(r_.columns);
    std::fill(out.begin(), out.end(), 0.0);
    for (int t = 0; t < count_; ++t) {
      const Mat<double, 3, 2> f = columns_of(x, t);
      double *to = &out[std::size_t(3 * t) * width];
      const double *b = r_.hats + 6 * t;
      for (int a = 0; a < 3; ++a)
        for (int i = 0; i < 3; ++i) {
          const double u = f(i, 0) * b[2 * a], v = f(i, 1) * b[2 * a + 1];
          const double w = f(i, 0) * b[2 * a + 1] + f(i, 1) * b[2 * a];
          const double *from = dx + (3 * std::size_t(node(t, a)) + i) * width;
          for (int c = 0; c < width; ++c) {
            to[c] += u * from[c];
            to[width + c] += v * from[c];
            to[2 * width + c] += w * from[c];
          }
        }
    }
  }

  const Record &r_;
  int count_;
  bool damped_ = false;
  Rates rates_{1.0, 0.0, 1.0};
  std::vector<double> base_, slope_now_, slope_past_;
  std::vector<Slot> slots_;
};

class Hinges {
 public:
  explicit Hinges(const Record &record) : r_(record), count_(int(record.hinges)) {
    for (int k = 0; k < r_.couplings; ++k) damped_ = damped_ || r_.bend_damping[k] != 0.0;
    for (int64_t k = 0; k < r_.bend_blocks * r_.couplings; ++k) damped_ = damped_ || r_.d_bend_damping[k] != 0.0;
    angle_.assign(count_, 0.0);
    base_.assign(count_, 0.0);
    moment_.assign(count_, 0.0);
    slope_.assign(12 * count_, 0.0);
    whole_.assign(r_.couplings, 0.0);
    seen_.assign(std::size_t(3) * r_.nodes, std::numeric_limits<double>::quiet_NaN());
    turn_now_.assign(damped_ ? r_.hinges * r_.columns : 0, 0.0);
    turn_past_ = turn_now_;
    find_stencils();
  }

  void couple(Blocks &h) const {
    for (int e = 0; e < count_; ++e)
      for (int a = 0; a < 4; ++a)
        for (int k = first_[e]; k < first_[e + 1]; ++k) h.couple(node(e, a), stencil_[k]);
  }
  void bind(const Blocks &h) {
    inner_.clear();
    outer_.clear();
    for (int e = 0; e < count_; ++e)
      for (int a = 0; a < 4; ++a)
        for (int k = first_[e]; k < first_[e + 1]; ++k) {
          const Slot slot = h.slot(node(e, a), stencil_[k]);
          inner_.push_back(slot.turned ? -1 : slot.at);
        }
    for (int e = 0; e < count_; ++e)
      for (int side = 0; side < 2; ++side)
        for (int i = 0; i < 3; ++i)
          for (int j = i; j < 3; ++j) outer_.push_back(h.slot(corner(e, side, i), corner(e, side, j)));
  }

  void begin(const double *x_start, const double *x_past, const Rates &rates) {
    for (int k = 0; k < r_.couplings; ++k) whole_[k] = r_.bend_stiffness[k] + r_.bend_damping[k] / rates.tau;
    rates_ = rates;
    if (!damped_) return;
    for (int e = 0; e < count_; ++e) {
      base_[e] = rates.now * turned(x_start, e);
      if (x_past) base_[e] += rates.before * turned(x_past, e);
    }
  }

  double energy(const double *x) {
    if (!seen(x))
      for (int first = 0; first < count_; first += Pack::size) measure_angles(x, first);
    double out = 0.0;
    for (int e = 0; e < count_; ++e) {
      double held = 0.0, rubbed = 0.0;
      for (int k = r_.coupling_start[e]; k < r_.coupling_start[e + 1]; ++k) {
        const int o = r_.coupling_column[k];
        held += r_.bend_stiffness[k] * angle_[o];
        if (damped_) rubbed += r_.bend_damping[k] * (angle_[o] - base_[o]);
      }
      out += 0.5 * angle_[e] * held + 0.5 * (angle_[e] - base_[e]) * rubbed / rates_.tau;
    }
    return out;
  }

  void add_gradient(const double *x, double *out) {
    measure(x);
    for (int e = 0; e < count_; ++e)
      for (int a = 0; a < 4; ++a)
        for (int i = 0; i < 3; ++i) out[3 * node(e, a) + i] += moment_[e] * slope_[12 * e + 3 * a + i];
  }

  void add_hessian(const double *x, bool exact, Blocks &h) {
    measure(x);
    const int *slot = inner_.data();
    for (int e = 0; e < count_; ++e) {
      const int size = first_[e + 1] - first_[e];
      row_.assign(3 * size, 0.0);
      const int *place = &place_[4 * r_.coupling_start[e]];
      for (int k = r_.coupling_start[e]; k < r_.coupling_start[e + 1]; ++k, place += 4) {
        const double *g = &slope_[12 * r_.coupling_column[k]];
        for (int a = 0; a < 4; ++a)
          for (int i = 0; i < 3; ++i) row_[3 * place[a] + i] += whole_[k] * g[3 * a + i];
      }
      for (int a = 0; a < 4; ++a) {
        const double *g = &slope_[12 * e + 3 * a];
        for (int q = 0; q < size; ++q, ++slot) {
          if (*slot < 0) continue;
          double *to = h.block(*slot);
          const double *w = &row_[3 * q];
          for (int i = 0; i < 3; ++i)
            for (int j = 0; j < 3; ++j) to[3 * i + j] += g[i] * w[j];
        }
      }
    }
    if (exact) add_curved(x, h);
  }

  void keep_slopes(const double *x, const double *dx) {
    if (!damped_) return;
    turn_past_.swap(turn_now_);
    measure_slopes(x, dx);
  }
  void restart_slopes(const double *x, const double *dx) {
    if (damped_) measure_slopes(x, dx);
  }

  void add_columns(const double *x, double *out) {
    const int width = int(r_.columns);
    if (!damped_ && !r_.bend_blocks) return;
    measure(x);
    std::vector<double> base(damped_ ? count_ * width : 0), change(width);
    for (std::size_t k = 0; k < base.size(); ++k) base[k] = rates_.now * turn_now_[k] + rates_.before * turn_past_[k];
    for (int e = 0; e < count_; ++e) {
      std::fill(change.begin(), change.end(), 0.0);
      for (int k = r_.coupling_start[e]; k < r_.coupling_start[e + 1]; ++k) {
        const int o = r_.coupling_column[k];
        if (damped_) {
          const double by = -r_.bend_damping[k] / rates_.tau;
          for (int c = 0; c < width; ++c) change[c] += by * base[std::size_t(o) * width + c];
        }
        for (int m = 0; m < r_.bend_blocks; ++m) {
          const std::size_t at = std::size_t(m) * r_.couplings + k;
          change[r_.bend_of[m]] += r_.d_bend_stiffness[at] * angle_[o] +
                                   r_.d_bend_damping[at] / rates_.tau * (angle_[o] - base_[o]);
        }
      }
      for (int a = 0; a < 4; ++a)
        for (int i = 0; i < 3; ++i) {
          double *to = out + (3 * std::size_t(node(e, a)) + i) * width;
          const double by = slope_[12 * e + 3 * a + i];
          for (int c = 0; c < width; ++c) to[c] += by * change[c];
        }
    }
  }

  std::vector<double> &slope_now() { return turn_now_; }
  std::vector<double> &slope_past() { return turn_past_; }

 private:
  int node(int e, int a) const { return r_.hinge[4 * e + a]; }
  // Nodes of the triangle on one side of a hinge, its apex last.
  int corner(int e, int side, int i) const { return node(e, i < 2 ? i : 2 + side); }
  Vec3 at(const double *x, int e, int a) const { return point(x, node(e, a)); }
  double turned(const double *x, int e) const {
    return laws::dihedral::angle(at(x, e, 0), at(x, e, 1), at(x, e, 2), at(x, e, 3)) - r_.rest_angle[e];
  }

  // Nodes that a hinge is coupled to, and where the nodes of its partners are among them.
  void find_stencils() {
    first_.assign(1, 0);
    place_.resize(4 * r_.couplings);
    for (int e = 0; e < count_; ++e) {
      std::vector<int> nodes;
      for (int k = r_.coupling_start[e]; k < r_.coupling_start[e + 1]; ++k)
        for (int a = 0; a < 4; ++a) nodes.push_back(node(r_.coupling_column[k], a));
      std::sort(nodes.begin(), nodes.end());
      nodes.erase(std::unique(nodes.begin(), nodes.end()), nodes.end());
      for (int k = r_.coupling_start[e]; k < r_.coupling_start[e + 1]; ++k)
        for (int a = 0; a < 4; ++a)
          place_[4 * k + a] =
              int(std::lower_bound(nodes.begin(), nodes.end(), node(r_.coupling_column[k], a)) - nodes.begin());
      stencil_.insert(stencil_.end(), nodes.begin(), nodes.end());
      first_.push_back(int(stencil_.size()));
    }
  }

  using Four = Vec<Pack, 3>;

  // One of the nodes of four hinges; beyond the last hinge the last one again.
  Four four(const double *x, int first, int a) const {
    Four out;
    for (int l = 0; l < Pack::size; ++l) {
      const int i = node(std::min(first + l, count_ - 1), a);
      for (int k = 0; k < 3; ++k) out[k].a[l] = x[3 * i + k];
    }
    return out;
  }
  int lanes_from(int first) const { return std::min(Pack::size, count_ - first); }

  bool seen(const double *x) const { return std::equal(seen_.begin(), seen_.end(), x); }

  void measure_angles(const double *x, int first) {
    seen_[0] = std::numeric_limits<double>::quiet_NaN();  // slopes are not those of these angles
    const Pack found = laws::dihedral::angle(four(x, first, 0), four(x, first, 1), four(x, first, 2), four(x, first, 3));
    for (int l = 0; l < lanes_from(first); ++l) angle_[first + l] = found.a[l] - r_.rest_angle[first + l];
  }

  // Angles, their slopes and the moments on the hinges.
  void measure(const double *x) {
    if (!seen(x)) {
      for (int first = 0; first < count_; first += Pack::size) {
        const Four p = four(x, first, 0), q = four(x, first, 1), u = four(x, first, 2), v = four(x, first, 3);
        const Pack found = laws::dihedral::angle(p, q, u, v);
        const auto g = laws::dihedral::angle_gradient(p, q, u, v);
        for (int l = 0; l < lanes_from(first); ++l) {
          angle_[first + l] = found.a[l] - r_.rest_angle[first + l];
          for (int k = 0; k < 12; ++k) slope_[12 * (first + l) + k] = g[k].a[l];
        }
      }
      std::copy(x, x + seen_.size(), seen_.begin());
    }
    for (int e = 0; e < count_; ++e) {
      double total = 0.0;
      for (int k = r_.coupling_start[e]; k < r_.coupling_start[e + 1]; ++k) {
        const int o = r_.coupling_column[k];
        total += whole_[k] * angle_[o];
        if (damped_) total -= r_.bend_damping[k] / rates_.tau * base_[o];
      }
      moment_[e] = total;
    }
  }

  // Moments times the second derivatives of the angles, side by side (sim_core/energies/dihedral.py).
  void add_curved(const double *x, Blocks &h) const {
    for (int first = 0; first < count_; first += Pack::size) {
      Pack moment(0.0);
      for (int l = 0; l < lanes_from(first); ++l) moment.a[l] = moment_[first + l];
      for (int side = 0; side < 2; ++side) {
        const auto [n, along, up, dc, dphi] = laws::dihedral::side_curvature(
            four(x, first, 0), four(x, first, 1), four(x, first, 2 + side), Pack(side ? -1.0 : 1.0));
        int pair = 0;
        for (int i = 0; i < 3; ++i)
          for (int j = i; j < 3; ++j, ++pair) {
            const Four left = moment * (dc(i, 2 * j) * along + dc(i, 2 * j + 1) * up);
            const Four right = (moment * dphi(i, 2)) * (dphi(j, 0) * along + dphi(j, 1) * up);
            Mat<Pack, 3, 3> block;
            for (int a = 0; a < 3; ++a)
              for (int b = 0; b < 3; ++b) block(a, b) = n[a] * left[b] - right[a] * n[b];
            if (i == j) block = 0.5 * (block + block.transpose());
            for (int l = 0; l < lanes_from(first); ++l) {
              const Slot slot = outer_[12 * (first + l) + 6 * side + pair];
              double *to = h.block(slot.at);
              const int down = slot.turned ? 1 : 3, right_by = slot.turned ? 3 : 1;
              for (int a = 0; a < 3; ++a)
                for (int b = 0; b < 3; ++b) to[down * a + right_by * b] += block(a, b).a[l];
            }
          }
      }
    }
  }

  void measure_slopes(const double *x, const double *dx) {
    const int width = int(r_.columns);
    measure(x);
    std::fill(turn_now_.begin(), turn_now_.end(), 0.0);
    for (int e = 0; e < count_; ++e)
      for (int a = 0; a < 4; ++a)
        for (int i = 0; i < 3; ++i) {
          const double by = slope_[12 * e + 3 * a + i];
          const double *from = dx + (3 * std::size_t(node(e, a)) + i) * width;
          for (int c = 0; c < width; ++c) turn_now_[std::size_t(e) * width + c] += by * from[c];
        }
  }

  const Record &r_;
  int count_;
  bool damped_ = false;
  Rates rates_{1.0, 0.0, 1.0};
  std::vector<double> angle_, base_, moment_, slope_, whole_, row_, seen_, turn_now_, turn_past_;
  std::vector<int> first_, stencil_, place_, inner_;
  std::vector<Slot> outer_;
};

}  // namespace thinshell
