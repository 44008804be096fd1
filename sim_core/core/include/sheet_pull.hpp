// Triangles and hinges of sheets on the way back (elements_pull.hpp).
#pragma once

#include "hinges.hpp"
#include "strain_laws_pull.hpp"
#include "triangles.hpp"

namespace thinshell {

template <> struct Pull<Triangles> {
  Pull<StrainLaws<3>> laws;

  Pull(Triangles &triangles, const Record &record) : laws(triangles.laws, record), t_(triangles), r_(record) {}

  void to_end(const double *x, std::vector<double> &end) {
    if (!t_.laws.any()) return;
    std::vector<double> strain(3 * t_.count_, 0.0);
    laws.to_end(t_.strains(x), strain);
    spread(x, strain, 1.0, end.data());
  }
  void to_start(const double *x, const double *x_start, const double *x_past, StepWeights &w) {
    if (!t_.damped_ && !r_.stretch_blocks && !t_.laws.any() && !w.by_elements) return;
    const std::vector<double> along = turned(x, w.residual.data());
    std::vector<double> start(t_.laws.any() ? along.size() : 0, 0.0), end(along.size(), 0.0), base(along.size(), 0.0);
    std::vector<double> stress(along.size(), 0.0);
    if (t_.laws.any()) {
      laws.to_start(t_.strains(x), along, start, end, w);
      spread(x_start, start, 1.0, w.start.data());
      if (w.by_shapes) std::copy_n(t_.laws.stress(t_.strains(x)), stress.size(), stress.begin());
    }
    for (int t = 0; t < t_.count_; ++t) {
      const Vec3 own = point(along.data(), t);
      const double *k = r_.stretch_stiffness + 9 * t;
      if (t_.damped_)
        for (int j = 0; j < 3; ++j)
          for (int i = 0; i < 3; ++i) base[3 * t + j] -= t_.rate(t) * k[3 * i + j] * own[i];
      if (!r_.stretch_blocks && !w.by_elements) continue;
      const Vec3 e = Triangles::strain(t_.columns_of(x, t)), since = t_.damped_ ? Vec3(e - t_.base(t)) : Vec3{};
      const Vec3 whole = e + t_.rate(t) * since;
      for (int i = 0; w.by_shapes && i < 3; ++i)
        for (int j = 0; j < 3; ++j) {
          end[3 * t + j] += (1.0 + t_.rate(t)) * k[3 * i + j] * own[i];
          stress[3 * t + i] += k[3 * i + j] * whole[j];
        }
      const double growth = w.gradings->growth(int(Strained::MEMBRANE), t);
      for (int i = 0; w.by_elements && i < 3; ++i)
        for (int j = 0; j < 3; ++j) {
          w.elements.stretch_stiffness[9 * t + 3 * i + j] += growth * own[i] * whole[j];
          w.elements.stretch_damping[t] += own[i] * k[3 * i + j] * since[j] / t_.rates_.tau;
        }
      for (int m = 0; m < r_.stretch_blocks; ++m) {
        const double *dk = r_.d_stretch_stiffness + (std::size_t(m) * t_.count_ + t) * 9;
        const double more = r_.d_stretch_damping[std::size_t(m) * t_.count_ + t] / t_.rates_.tau;
        for (int i = 0; i < 3; ++i)
          for (int j = 0; j < 3; ++j)
            w.numbers[r_.stretch_of[m]] += own[i] * (dk[3 * i + j] * whole[j] + more * k[3 * i + j] * since[j]);
      }
    }
    if (w.by_shapes) {
      std::vector<double> &hats = w.elements.hats;
      const double *y = w.residual.data();
      unshape(x, x, end, 1.0, hats);
      unshape(y, x, stress, 1.0, hats);  // of moves, which strain as positions do
      unshape(x, y, stress, 1.0, hats);
      if (t_.laws.any()) unshape(x_start, x_start, start, 1.0, hats);
      unshape(x_start, x_start, base, t_.rates_.now, hats);
      if (x_past) unshape(x_past, x_past, base, t_.rates_.before, hats);
    }
    if (!t_.damped_) return;
    spread(x_start, base, t_.rates_.now, w.start.data());
    if (x_past) spread(x_past, base, t_.rates_.before, w.past.data());
  }

 private:
  // From weights of the strains, times a number, to those of the gradients of the hat functions, added, at nodes `x` whose
  // deformation meets that of nodes `y` in them.
  void unshape(const double *x, const double *y, const std::vector<double> &strain, double by, std::vector<double> &out) const {
    for (int t = 0; t < t_.count_; ++t) {
      const Vec3 s = by * point(strain.data(), t);
      if (s.norm_sqr() == 0.0) continue;
      const Mat<double, 3, 2> f = t_.columns_of(y, t);
      for (int a = 0; a < 3; ++a)
        for (int i = 0; i < 3; ++i) {
          const double at = x[3 * t_.node(t, a) + i];
          out[6 * t + 2 * a] += at * (s[0] * f(i, 0) + s[2] * f(i, 1));
          out[6 * t + 2 * a + 1] += at * (s[2] * f(i, 0) + s[1] * f(i, 1));
        }
    }
  }
  // Changes of the strains by moves of the nodes.
  std::vector<double> turned(const double *x, const double *move) const {
    std::vector<double> out(3 * t_.count_, 0.0);
    for (int t = 0; t < t_.count_; ++t) {
      const Mat<double, 3, 2> f = t_.columns_of(x, t), d = t_.columns_of(move, t);
      for (int i = 0; i < 3; ++i) {
        out[3 * t] += f(i, 0) * d(i, 0);
        out[3 * t + 1] += f(i, 1) * d(i, 1);
        out[3 * t + 2] += f(i, 0) * d(i, 1) + f(i, 1) * d(i, 0);
      }
    }
    return out;
  }
  // The transpose of that, times a number, added.
  void spread(const double *x, const std::vector<double> &strain, double by, double *out) const {
    for (int t = 0; t < t_.count_; ++t) {
      const Vec3 s = by * point(strain.data(), t);
      if (s.norm_sqr() == 0.0) continue;
      const Mat<double, 3, 2> f = t_.columns_of(x, t);
      const double *b = r_.hats + 6 * t;
      for (int a = 0; a < 3; ++a)
        for (int i = 0; i < 3; ++i)
          out[3 * t_.node(t, a) + i] += f(i, 0) * (s[0] * b[2 * a] + s[2] * b[2 * a + 1]) +
                                        f(i, 1) * (s[2] * b[2 * a] + s[1] * b[2 * a + 1]);
    }
  }

  Triangles &t_;
  const Record &r_;
};

template <> struct Pull<Hinges> {
  Pull<StrainLaws<3>> laws;

  Pull(Hinges &hinges, const Record &record) : laws(hinges.laws, record), h_(hinges), r_(record) {}

  void to_end(const double *x, std::vector<double> &end) {
    if (!h_.laws.any()) return;
    h_.measure(x);
    std::vector<double> bent(3 * r_.bent, 0.0), turn(h_.count_, 0.0);
    laws.to_end(h_.curvatures(h_.angle_), bent);
    unbend(bent, turn);
    for (int e = 0; e < h_.count_; ++e) lever(&h_.slope_[12 * e], e, turn[e], end.data());
  }
  void to_start(const double *x, const double *x_start, const double *x_past, StepWeights &w) {
    if (!h_.damped_ && !r_.bend_blocks && !h_.laws.any() && !w.by_elements) return;
    h_.measure(x);
    std::vector<double> along(h_.count_, 0.0), start(h_.count_, 0.0), past(h_.count_, 0.0);
    for (int e = 0; e < h_.count_; ++e)
      for (int a = 0; a < 4; ++a)
        for (int i = 0; i < 3; ++i) along[e] += h_.slope_[12 * e + 3 * a + i] * w.residual[3 * h_.node(e, a) + i];
    for (int e = 0; e < h_.count_; ++e)
      for (int k = r_.coupling_start[e]; k < r_.coupling_start[e + 1]; ++k) {
        const int o = r_.coupling_column[k];
        if (h_.damped_) {
          const double by = -r_.bend_damping[k] / h_.rates_.tau * along[e];
          start[o] += h_.rates_.now * by;
          past[o] += h_.rates_.before * by;
        }
        if (w.by_elements) w.elements.rest_angle[o] -= along[e] * r_.bend_stiffness[k];  // rates do not depend on it
        for (int m = 0; m < r_.bend_blocks; ++m) {
          const std::size_t at = std::size_t(m) * r_.couplings + k;
          double by = r_.d_bend_stiffness[at] * h_.angle_[o];
          if (h_.damped_) by += r_.d_bend_damping[at] / h_.rates_.tau * (h_.angle_[o] - h_.base_[o]);
          w.numbers[r_.bend_of[m]] += along[e] * by;
        }
      }
    if (h_.laws.any()) {
      std::vector<double> stress(3 * r_.bent, 0.0), bent(3 * r_.bent, 0.0), end(3 * r_.bent, 0.0);
      h_.each_bent([&](int t, int k) {
        for (int i = 0; i < 3; ++i) stress[3 * t + i] += r_.bent_weight[3 * k + i] * along[r_.bent_hinge[k]];
      });
      laws.to_start(h_.curvatures(h_.angle_), stress, bent, end, w);
      unbend(bent, start);
      if (w.by_shapes) {
        const double *exerted = h_.laws.stress(h_.curvatures(h_.angle_));
        each_curved(w.curving, [&](int t, int p, int hinge) {
          const int b = w.curving.bent[t];
          for (int i = 0; b >= 0 && i < 3; ++i)
            w.elements.operator_law[3 * p + i] += end[3 * b + i] * h_.angle_[hinge] + bent[3 * b + i] * h_.started_[hinge] +
                                                  exerted[3 * b + i] * along[hinge];
        });
      }
    }
    if (w.by_elements) to_triangles(along, w);
    turn(x_start, start, w.start.data());
    if (x_past) turn(x_past, past, w.past.data());
  }

 private:
  // f(triangle, pair, hinge) of all hinges around each triangle.
  template <class F> static void each_curved(const Curving &c, F &&f) {
    for (int t = 0; t < c.triangles; ++t)
      for (int p = c.start[t]; p < c.start[t + 1]; ++p) f(t, p, c.hinge[p]);
  }
  // What triangles have of the work of the moments along moves that turn hinges.
  void to_triangles(const std::vector<double> &along, StepWeights &w) const {
    const Curving &c = w.curving;
    std::vector<double> since(h_.count_, 0.0);
    for (int e = 0; h_.damped_ && e < h_.count_; ++e) since[e] = (h_.angle_[e] - h_.base_[e]) / h_.rates_.tau;
    std::vector<Vec3> turned(c.triangles, Vec3{}), bent = turned, rubbed = turned;
    each_curved(c, [&](int t, int p, int hinge) {
      turned[t] += along[hinge] * point(c.weight, p);
      bent[t] += h_.angle_[hinge] * point(c.weight, p);
      rubbed[t] += since[hinge] * point(c.weight, p);
    });
    for (int t = 0; t < c.triangles; ++t) {
      if (c.graded[t] >= 0) turned[t] *= w.gradings->growth(c.graded[t]);
      for (int k = 0; k < 9; ++k) {
        w.elements.curve_stiffness[9 * t + k] += turned[t][k / 3] * bent[t][k % 3];
        w.elements.curve_damping[9 * t + k] += turned[t][k / 3] * rubbed[t][k % 3];
      }
    }
    if (!w.by_shapes) return;
    each_curved(c, [&](int t, int p, int hinge) {
      const double own = along[hinge] * (c.graded[t] >= 0 ? w.gradings->growth(c.graded[t]) : 1.0);
      for (int i = 0; i < 3; ++i) {
        w.elements.operator_stiffness[3 * p + i] += own * bent[t][i] + turned[t][i] * h_.angle_[hinge];
        w.elements.operator_damping[3 * p + i] += own * rubbed[t][i] + turned[t][i] * since[hinge];
      }
    });
  }
  // From weights of curvatures to those of angles, added.
  void unbend(const std::vector<double> &bent, std::vector<double> &turn) const {
    h_.each_bent([&](int t, int k) { turn[r_.bent_hinge[k]] += point(r_.bent_weight, k).dot(point(bent.data(), t)); });
  }
  // From those of one angle, whose slopes are known, to those of its nodes.
  void lever(const double *slope, int e, double weight, double *out) const {
    for (int a = 0; a < 4; ++a)
      for (int i = 0; i < 3; ++i) out[3 * h_.node(e, a) + i] += weight * slope[3 * a + i];
  }
  // From those of angles at positions to those of the nodes.
  void turn(const double *x, const std::vector<double> &weight, double *out) const {
    if (std::all_of(weight.begin(), weight.end(), [](double w) { return w == 0.0; })) return;
    for (int first = 0; first < h_.count_; first += Pack::size) {
      const auto g = laws::dihedral::angle_gradient(h_.four(x, first, 0), h_.four(x, first, 1), h_.four(x, first, 2),
                                                    h_.four(x, first, 3));
      for (int l = 0; l < h_.lanes_from(first); ++l) {
        double slope[12];
        for (int k = 0; k < 12; ++k) slope[k] = g[k].a[l];
        lever(slope, first + l, weight[first + l], out);
      }
    }
  }

  Hinges &h_;
  const Record &r_;
};

}  // namespace thinshell
