// Hinges of sheets that bend (elements.hpp).
#pragma once

#include "elements.hpp"

namespace thinshell {

class Hinges {
 public:
  explicit Hinges(const Record &record)
      : laws(record, Strained::BENDING, int(record.bent)), r_(record), count_(int(record.hinges)) {
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
    if (!laws.any()) return;
    softened_.assign(r_.couplings, 0.0);
    moved_.assign(r_.hinges * r_.columns, 0.0);
    bending_.assign(3 * r_.bent * r_.columns, 0.0);
    started_.assign(count_, 0.0);
  }

  StrainLaws<3> laws;  // of curvatures of triangles

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
    if (laws.any()) {
      bears_ = false;
      for (int e = 0; e < count_; ++e) started_[e] = turned(x_start, e);
      laws.begin(curvatures(started_), rates.dt);
    }
    if (!damped_) return;
    for (int e = 0; e < count_; ++e) {
      base_[e] = rates.now * turned(x_start, e);
      if (x_past) base_[e] += rates.before * turned(x_past, e);
    }
  }

  double energy(const double *x) {
    if (!seen(x))
      for (int first = 0; first < count_; first += Pack::size) measure_angles(x, first);
    double out = laws.energy(curvatures(angle_));
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
    if (laws.any()) soften(exact);
    const std::vector<double> &stiff = laws.any() ? softened_ : whole_;
    const int *slot = inner_.data();
    for (int e = 0; e < count_; ++e) {
      const int size = first_[e + 1] - first_[e];
      row_.assign(3 * size, 0.0);
      const int *place = &place_[4 * r_.coupling_start[e]];
      for (int k = r_.coupling_start[e]; k < r_.coupling_start[e + 1]; ++k, place += 4) {
        const double *g = &slope_[12 * r_.coupling_column[k]];
        for (int a = 0; a < 4; ++a)
          for (int i = 0; i < 3; ++i) row_[3 * place[a] + i] += stiff[k] * g[3 * a + i];
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

  void end(const double *x) {
    if (!laws.any()) return;
    measure(x);
    laws.end(curvatures(angle_));
  }

  void keep_slopes(const double *x, const double *dx) {
    if (laws.any()) {
      measure_bending(x, dx);
      laws.end_columns(curvatures(angle_), bending_);
    }
    if (!damped_) return;
    turn_past_.swap(turn_now_);
    measure_slopes(x, dx, turn_now_);
  }
  void restart_slopes(const double *x, const double *dx) {
    if (damped_) measure_slopes(x, dx, turn_now_);
    if (!laws.any()) return;
    measure_bending(x, dx);
    laws.restart(bending_);
  }

  void add_columns(const double *x, double *out) {
    const int width = int(r_.columns);
    if (!damped_ && !r_.bend_blocks && !laws.any()) return;
    measure(x);
    std::vector<double> added(moved_.size(), 0.0);
    if (laws.any()) bear_columns(added);
    std::vector<double> base(damped_ ? count_ * width : 0), change(width);
    for (std::size_t k = 0; k < base.size(); ++k) base[k] = rates_.now * turn_now_[k] + rates_.before * turn_past_[k];
    for (int e = 0; e < count_; ++e) {
      if (laws.any())
        std::copy_n(&added[std::size_t(e) * width], width, change.begin());
      else
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
  template <class> friend struct Pull;

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
    bears_ = false;
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
      bears_ = false;
    }
    if (laws.any() && !bears_) {
      borne_.assign(count_, 0.0);
      const double *stress = laws.stress(curvatures(angle_));
      each_bent([&](int t, int k) { borne_[r_.bent_hinge[k]] += point(stress, t).dot(point(r_.bent_weight, k)); });
      bears_ = true;
    }
    for (int e = 0; e < count_; ++e) {
      double total = laws.any() ? borne_[e] : 0.0;
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
        const auto curvature = laws::dihedral::side_curvature(four(x, first, 0), four(x, first, 1), four(x, first, 2 + side),
                                                              Pack(side ? -1.0 : 1.0));
        int pair = 0;
        for (int i = 0; i < 3; ++i)
          for (int j = i; j < 3; ++j, ++pair) {
            const Mat<Pack, 3, 3> block = side_block(moment, curvature, i, j);
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

  // Curvatures of triangles at angles of the hinges.
  struct Curvatures {
    const Record &r;
    const std::vector<double> &angles;
    void operator()(int t, double *e) const {
      Vec3 found{};
      for (int k = r.bent_start[t]; k < r.bent_start[t + 1]; ++k) found += angles[r.bent_hinge[k]] * point(r.bent_weight, k);
      std::copy(found.a, found.a + 3, e);
    }
  };
  Curvatures curvatures(const std::vector<double> &angles) const { return {r_, angles}; }
  template <class F> void each_bent(F &&f) const {
    for (int t = 0; t < r_.bent; ++t)
      for (int k = r_.bent_start[t]; k < r_.bent_start[t + 1]; ++k) f(t, k);
  }
  // Stiffness of all couplings with the tangents of the laws.
  void soften(bool exact) {
    softened_ = whole_;
    const double *tangent = laws.tangent(curvatures(angle_), exact, true);
    each_bent([&](int t, int k) {
      const Vec3 left = matmul(square_of(tangent + 9 * t), point(r_.bent_weight, k));
      const int32_t *row = r_.coupling_column + r_.coupling_start[r_.bent_hinge[k]];
      const int32_t *last = r_.coupling_column + r_.coupling_start[r_.bent_hinge[k] + 1];
      for (int o = r_.bent_start[t]; o < r_.bent_start[t + 1]; ++o)
        softened_[std::lower_bound(row, last, r_.bent_hinge[o]) - r_.coupling_column] += left.dot(point(r_.bent_weight, o));
    });
  }
  static Mat3 square_of(const double *m) {
    Mat3 out;
    std::copy(m, m + 9, out.a);
    return out;
  }
  // Changes of the moments on the hinges by the laws, at held angles (hinges, columns).
  void bear_columns(std::vector<double> &out) {
    const int width = int(r_.columns);
    std::vector<double> stress(bending_.size(), 0.0);
    laws.add_columns(curvatures(angle_), stress.data());
    each_bent([&](int t, int k) {
      double *to = &out[std::size_t(r_.bent_hinge[k]) * width];
      for (int i = 0; i < 3; ++i)
        for (int c = 0; c < width; ++c) to[c] += r_.bent_weight[3 * k + i] * stress[(std::size_t(3) * t + i) * width + c];
    });
  }
  // Derivatives of the curvatures, from those of the positions.
  void measure_bending(const double *x, const double *dx) {
    const int width = int(r_.columns);
    measure_slopes(x, dx, moved_);
    std::fill(bending_.begin(), bending_.end(), 0.0);
    each_bent([&](int t, int k) {
      const double *from = &moved_[std::size_t(r_.bent_hinge[k]) * width];
      for (int i = 0; i < 3; ++i)
        for (int c = 0; c < width; ++c) bending_[(std::size_t(3) * t + i) * width + c] += r_.bent_weight[3 * k + i] * from[c];
    });
  }

  void measure_slopes(const double *x, const double *dx, std::vector<double> &out) {
    const int width = int(r_.columns);
    measure(x);
    std::fill(out.begin(), out.end(), 0.0);
    for (int e = 0; e < count_; ++e)
      for (int a = 0; a < 4; ++a)
        for (int i = 0; i < 3; ++i) {
          const double by = slope_[12 * e + 3 * a + i];
          const double *from = dx + (3 * std::size_t(node(e, a)) + i) * width;
          for (int c = 0; c < width; ++c) out[std::size_t(e) * width + c] += by * from[c];
        }
  }

  const Record &r_;
  int count_;
  bool damped_ = false;
  Rates rates_{1.0, 0.0, 1.0, 1.0};
  bool bears_ = false;  // whether `borne_` has the laws' moments at the angles at hand
  std::vector<double> angle_, base_, moment_, slope_, whole_, row_, seen_, turn_now_, turn_past_;
  std::vector<double> borne_, softened_, started_, moved_, bending_;
  std::vector<int> first_, stencil_, place_, inner_;
  std::vector<Slot> outer_;
};

}  // namespace thinshell
