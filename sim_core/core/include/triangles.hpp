// Triangles of sheets that stretch (elements.hpp).
#pragma once

#include "elements.hpp"

namespace thinshell {

class Triangles {
 public:
  explicit Triangles(const Record &record)
      : laws(record, Strained::MEMBRANE, int(record.triangles)), r_(record), count_(int(record.triangles)),
        base_(3 * record.triangles) {
    for (int t = 0; t < count_; ++t) damped_ = damped_ || r_.stretch_damping[t] != 0.0;
    for (int k = 0; k < r_.stretch_blocks; ++k)
      for (int t = 0; t < count_; ++t) damped_ = damped_ || r_.d_stretch_damping[std::size_t(k) * count_ + t] != 0.0;
    slope_now_.assign(damped_ ? 3 * r_.triangles * r_.columns : 0, 0.0);
    slope_past_ = slope_now_;
    moved_.assign(laws.any() ? 3 * r_.triangles * r_.columns : 0, 0.0);
  }

  StrainLaws<3> laws;

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
    laws.begin(strains(x_start), rates.dt);
    if (!damped_) return;
    for (int t = 0; t < count_; ++t) {
      Vec3 base = rates.now * strain(columns_of(x_start, t));
      if (x_past) base += rates.before * strain(columns_of(x_past, t));
      for (int i = 0; i < 3; ++i) base_[3 * t + i] = base[i];
    }
  }

  double energy(const double *x) {
    double out = laws.energy(strains(x));
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

  void add_gradient(const double *x, double *out) {
    const double *added = laws.any() ? laws.stress(strains(x)) : nullptr;
    for (int t = 0; t < count_; ++t) {
      const Mat<double, 3, 2> f = columns_of(x, t);
      Vec3 s = stress(t, strain(f));
      if (added) s += point(added, t);
      const double *b = r_.hats + 6 * t;
      for (int a = 0; a < 3; ++a) add(out, node(t, a), corner_force(f, s, b, a));
    }
  }

  // `move`: by whose linear part the stress is foreseen (null: that of the positions). Without `exact` semidefinite.
  void add_hessian(const double *x, const double *move, bool exact, Blocks &h) {
    const double *added = laws.any() ? laws.tangent(strains(x), exact, true) : nullptr;
    for (int t = 0; t < count_; ++t) {
      const Mat<double, 3, 2> f = columns_of(x, t);
      Vec3 e = strain(f);
      if (move) e = foreseen_strain(e, columns_of(move, t));
      Vec3 s = stress(t, e);
      if (added) s += point(laws.stresses(), t);
      if (!exact) s = laws::membrane::tension_of(s);
      double k[9];
      for (int i = 0; i < 9; ++i) k[i] = (1.0 + rate(t)) * r_.stretch_stiffness[9 * t + i] + (added ? added[9 * t + i] : 0.0);
      const double *b = r_.hats + 6 * t;
      const Slot *slot = &slots_[6 * t];
      for (int a = 0; a < 3; ++a)
        for (int d = a; d < 3; ++d, ++slot) {
          const Mat3 block = triangle_block(f, s, k, b, a, d);
          h.add(*slot, block);
        }
    }
  }

  void end(const double *x) { laws.end(strains(x)); }

  // Derivatives of the strains at the end of a step, from those of the positions (nodes, 3, columns).
  void keep_slopes(const double *x, const double *dx) {
    if (laws.any()) {
      measure_slopes(x, dx, moved_);
      laws.end_columns(strains(x), moved_);
    }
    if (!damped_) return;
    slope_past_.swap(slope_now_);
    measure_slopes(x, dx, slope_now_);
  }
  // A state without the one before it.
  void restart_slopes(const double *x, const double *dx) {
    if (damped_) measure_slopes(x, dx, slope_now_);
    if (!laws.any()) return;
    measure_slopes(x, dx, moved_);
    laws.restart(moved_);
  }

  // What forces change by at held positions, into (nodes, 3, columns).
  void add_columns(const double *x, double *out) {
    const int width = int(r_.columns);
    if (!damped_ && !r_.stretch_blocks && !laws.any()) return;
    std::vector<double> added(moved_.size(), 0.0);
    if (laws.any()) laws.add_columns(strains(x), added.data());
    std::vector<double> change(3 * width);
    for (int t = 0; t < count_; ++t) {
      const Mat<double, 3, 2> f = columns_of(x, t);
      const Vec3 e = strain(f), since = damped_ ? Vec3(e - base(t)) : Vec3{};
      const double *k = r_.stretch_stiffness + 9 * t;
      if (laws.any())
        std::copy_n(&added[std::size_t(3 * t) * width], 3 * width, change.begin());
      else
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
  template <class> friend struct Pull;

  int node(int t, int a) const { return r_.triangle[3 * t + a]; }
  double rate(int t) const { return r_.stretch_damping[t] / rates_.tau; }
  Vec3 base(int t) const { return point(base_.data(), t); }

  Mat<double, 3, 2> columns_of(const double *x, int t) const { return deformation(x, r_.triangle + 3 * t, r_.hats + 6 * t); }
  struct Strains {
    const Triangles &of;
    const double *x;
    void operator()(int t, double *e) const {
      const Vec3 found = strain(of.columns_of(x, t));
      std::copy(found.a, found.a + 3, e);
    }
  };
  Strains strains(const double *x) const { return {*this, x}; }
  static Vec3 strain(const Mat<double, 3, 2> &f) { return green_strain(f); }
  Vec3 stiff(int t, const Vec3 &e) const { return stiff_times(r_.stretch_stiffness + 9 * t, e); }
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
  Rates rates_{1.0, 0.0, 1.0, 1.0};
  std::vector<double> base_, slope_now_, slope_past_, moved_;
  std::vector<Slot> slots_;
};

}  // namespace thinshell
