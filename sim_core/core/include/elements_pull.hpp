// Elements on the way back: what their forces and memory pass on of their weights to where rates are measured from, what
// material laws remember, and the numbers. Forces by positions at the end are in the Hessian.
//
// With the weights y of the residual an element's work is s . (L y), L = de/dx its strains' derivatives (elements.hpp):
//
//     weights of e_b:    -B (L y) / tau,            passed on to the nodes by L^T at the start of the step
//     of a number p:     (L y) . [dK/dp e + dB/dp (e - e_b) / tau]
#pragma once

#include "contact_pull.hpp"
#include "drag.hpp"
#include "loads.hpp"
#include "tetrahedra.hpp"
#include "yielding.hpp"

namespace thinshell {

// Material laws of one kind of elements. `memory`: weights of what each remembers after the step, then before it.
template <int K> struct Pull<StrainLaws<K>> {
  std::vector<std::vector<double>> memory;

  Pull(StrainLaws<K> &laws, const Record &record) : l_(laws), r_(record) {
    for (auto &law : l_.laws_) memory.emplace_back(law.state.size(), 0.0);
  }
  std::vector<double> *of(int number) {
    for (std::size_t k = 0; k < memory.size(); ++k)
      if (l_.laws_[k].number == number) return &memory[k];
    return nullptr;
  }

  // Weights of the strains at the end by those of the memory (elements, K), added; `strain` as of StrainLaws.
  template <class F> void to_end(F &&strain, std::vector<double> &end) {
    for (std::size_t k = 0; k < memory.size(); ++k) {
      auto &law = l_.laws_[k];
      if (std::all_of(memory[k].begin(), memory[k].end(), [](double w) { return w == 0.0; })) continue;
      law.see(strain);
      for (int p = 0; p < law.count; ++p)
        along(law, p, nullptr, &memory[k][std::size_t(law.states) * p], K, [](int i, double *change) { change[i * lanes] = 1.0; },
              [&](int i, double w) { end[std::size_t(K) * law.element[p] + i] += w; });
    }
  }

  // Of the strains at the start and, by elements, at the end (elements, K), added, of the memory before the step, and of
  // numbers. `stress`: weights of the stresses times areas (elements, K).
  template <class F>
  void to_start(F &&strain, const std::vector<double> &stress, std::vector<double> &start, std::vector<double> &end,
                StepWeights &w) {
    for (std::size_t k = 0; k < memory.size(); ++k) {
      auto &law = l_.laws_[k];
      law.see(strain);
      law.exert();
      const int first_block = r_.material_block_start[law.number], last_block = r_.material_block_start[law.number + 1];
      std::vector<int> seen;  // of what a point sees
      for (int i = 0; i < law.inputs; ++i)
        if (w.by_elements || (i >= K && i < 2 * K) || (i >= law.first_state() && i < law.first_state() + law.states))
          seen.push_back(i);
      const int own_count = int(seen.size());
      std::vector<double> before(memory[k].size(), 0.0), row(law.inputs);
      for (int p = 0; p < law.count; ++p) {
        const double *own = &stress[std::size_t(K) * law.element[p]];
        const auto by = [&](int b) { return r_.d_material_row + r_.material_block_row[b] + std::size_t(law.inputs + 1) * p; };
        std::fill(row.begin(), row.end(), 0.0);
        along(
            law, p, own, &memory[k][std::size_t(law.states) * p], own_count + last_block - first_block,
            [&](int i, double *change) {
              if (i < own_count) change[seen[i] * lanes] = 1.0;
              for (int n = 0; i >= own_count && n < law.inputs; ++n) change[n * lanes] = by(first_block + i - own_count)[n];
            },
            [&](int i, double weight) {
              if (i < own_count)
                row[seen[i]] = weight;
              else
                w.numbers[r_.material_of[first_block + i - own_count]] += weight;
            });
        for (int i = 0; i < K; ++i) {
          start[std::size_t(K) * law.element[p] + i] += row[K + i];
          end[std::size_t(K) * law.element[p] + i] += row[i];
        }
        std::copy_n(&row[law.first_state()], law.states, &before[std::size_t(law.states) * p]);
        double work = 0.0;  // which grows with the area
        for (int i = 0; i < K; ++i) work += law.area[p] * law.out[(1 + K) * p + 1 + i] * own[i];
        for (int b = first_block; b < last_block; ++b) w.numbers[r_.material_of[b]] += by(b)[law.inputs] * work;
        if (!w.by_elements) continue;
        double *rows = &w.elements.material_row[r_.material_row_start[law.number] + std::size_t(law.inputs) * p];
        for (int i = 0; i < law.inputs; ++i) rows[i] += row[i];
        w.elements.material_area[r_.material_start[law.number] + p] += work;
      }
      memory[k].swap(before);
    }
  }

 private:
  // Derivatives of weighted stresses (null: none) and new internal variables of a point in `count` directions.
  // `direct(i, change)` writes one, every so many `lanes` a number; `give(i, derivative)` takes what is found.
  template <class Law, class D, class G>
  void along(Law &law, int p, const double *stress, const double *state, int count, D &&direct, G &&give) {
    bool stressed = false, remembered = false;
    for (int i = 0; stress && i < K; ++i) stressed = stressed || stress[i] != 0.0;
    for (int z = 0; z < law.states; ++z) remembered = remembered || state[z] != 0.0;
    if (!stressed && !remembered) return;
    change_.resize(law.changes());
    result_.resize(std::size_t(law.widest()) * lanes);
    for (int first = 0; first < count; first += lanes) {
      const int some = std::min(lanes, count - first);
      std::fill(change_.begin(), change_.end(), 0.0);
      for (int l = 0; l < some; ++l) direct(first + l, &change_[l]);
      double total[lanes] = {};
      auto sum = [&](int which, const double *weight, int rows, double by) {
        law.template function<PushFunction>(which)(1, law.row(p), change_.data(), result_.data());
        for (int i = 0; i < rows; ++i)
          for (int l = 0; l < some; ++l) total[l] += by * weight[i] * result_[lanes * i + l];
      };
      if (stressed) sum(3, stress, K, law.area[p]);
      if (remembered) sum(4, state, law.states, 1.0);
      for (int l = 0; l < some; ++l) give(first + l, total[l]);
    }
  }

  StrainLaws<K> &l_;
  const Record &r_;
  std::vector<double> change_, result_;
};

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

template <> struct Pull<Loads> {
  Pull(Loads &loads, const Record &record) : l_(loads), r_(record) {}

  void to_start(const double *x, StepWeights &w) {
    const std::vector<double> &y = w.residual;
    l_.each_dead([&](int k, int node, double weight) {
      for (int i = 0; i < 3; ++i) number(k, i, -l_.now_[k] * weight * y[3 * node + i], w);
    });
    l_.each_point([&](const Loads::Face &f, const Loads::Point &p) {
      constexpr int own = Loads::own, size = Loads::size;
      Dual2<double, size> z[size];
      l_.seed<size>(f, p, x, z);
      const auto found = Loads::swept(z);
      const double by = -l_.now_[f.load] * p.weight, pressure = l_.number(f.load)[0];
      double along[own] = {}, total = 0.0;  // of the weights, by u, g and h
      for (int k = 0; k < own; ++k) {
        for (int a = 0; a < f.nodes; ++a) along[k] += p.share(k / 3, a) * y[3 * f.node[a] + k % 3];
        total += along[k] * found.d[k];
      }
      number(f.load, 0, by * total, w);
      for (int l = 0; l < size; ++l) {
        if (l >= 3 && l < own) continue;  // sides at the end
        double back = 0.0;
        for (int k = 0; k < own; ++k) back += along[k] * found.second(k, l);
        const int part = l < 3 ? 0 : l / 3 - 2;
        for (int a = 0; a < f.nodes; ++a)
          w.start[3 * f.node[a] + l % 3] += (l < 3 ? -1.0 : 1.0) * by * pressure * back * p.share(part, a);
      }
    });
  }

 private:
  void number(int k, int i, double weight, StepWeights &w) const {
    for (int c = 0; c < r_.columns; ++c) w.numbers[c] += weight * r_.d_load_number[std::size_t(3 * k + i) * r_.columns + c];
  }
  Loads &l_;
  const Record &r_;
};

template <> struct Pull<Yielding> {
  Pull(Yielding &yielding, const Record &record) : y_(yielding), r_(record) {}

  void to_start(const double *x, StepWeights &w) {
    for (int a = 0; a < y_.count(); ++a)
      for (int c = 0; c < r_.columns; ++c)
        w.numbers[c] += w.residual[y_.first() + a] * r_.d_yield_spring[a * r_.columns + c] * x[y_.first() + a];
  }

 private:
  Yielding &y_;
  const Record &r_;
};

template <> struct Pull<Drag> {
  Pull(Drag &drag, const Record &record) : d_(drag), r_(record) {}

  void to_start(const double *x, const double *x_start, StepWeights &w) {
    const int own[3] = {0, 1, 2};
    for (int t = 0; t < d_.count_; ++t) {
      trace_.clear();
      const Trace::Scope scope(trace_);
      Noted start[9], force[9];
      double here[9];
      const auto at = [&](int k) { return 3 * std::size_t(d_.node(t, k / 3)) + k % 3; };
      for (int k = 0; k < 9; ++k) {
        start[k] = noted(x_start[at(k)]);
        here[k] = x[at(k)];
      }
      const auto corner = [&](int a) { return Vec<Noted, 3>{{start[3 * a], start[3 * a + 1], start[3 * a + 2]}}; };
      const Vec<Noted, 3> n = Drag::normal(corner(0), corner(1), corner(2));
      const Noted given = noted(r_.drag_factor[t]), factor = given / (d_.dt_ * d_.dt_);
      laws::air_drag::_gradient(View<const double, 2>(here, 3, 3), View<const Noted, 2>(start, 3, 3),
                                View<const int, 2>(own, 1, 3), View<const Noted, 2>(n.a, 1, 3),
                                View<const Noted, 1>(&factor, 1), View<Noted, 2>(force, 3, 3));
      for (int k = 0; k < 9; ++k)
        if (force[k].at) trace_.weight(force[k].at) += w.residual[at(k)];
      trace_.sweep(0, trace_.size());
      for (int k = 0; k < 9; ++k) w.start[at(k)] += trace_.weight(start[k].at);
      if (w.by_elements) w.elements.drag_factor[t] += trace_.weight(given.at);
      for (int c = 0; c < r_.columns; ++c)
        w.numbers[c] += trace_.weight(given.at) * r_.d_drag_factor[std::size_t(t) * r_.columns + c];
    }
  }

 private:
  Drag &d_;
  const Record &r_;
  Trace trace_;
};

template <> struct Pull<Tetrahedra> {
  static constexpr int corners = Tetrahedra::corners, points = Tetrahedra::points, components = Tetrahedra::components;
  Pull<StrainLaws<components>> laws;

  Pull(Tetrahedra &gels, const Record &record) : laws(gels.laws, record), g_(gels), r_(record) {}

  void to_end(const double *x, std::vector<double> &end) {
    if (!g_.laws.any()) return;
    g_.measure(x);
    std::vector<double> strain(std::size_t(components) * points * g_.count_, 0.0);
    laws.to_end(g_.strains(), strain);
    unstrain(x, strain, end);
  }
  void to_start(const double *x, const double *x_start, const double *x_past, StepWeights &w) {
    if (!g_.damped_ && !r_.gel_blocks && !g_.laws.any() && !w.by_elements) return;
    g_.measure(x);
    if (g_.laws.any()) {
      std::vector<double> along(std::size_t(components) * points * g_.count_, 0.0), start(along.size(), 0.0), end = start;
      for (int at = 0; at < points * g_.count_; ++at) {
        double m[9 * components];
        Tetrahedra::by_gradient(g_.gradient_now(at), m);
        const Mat3 moved = moved_at(w.residual.data(), at / points, at % points);
        for (int c = 0; c < components; ++c)
          for (int k = 0; k < 9; ++k) along[std::size_t(components) * at + c] += m[9 * c + k] * moved.a[k];
      }
      laws.to_start(g_.strains(), along, start, end, w);
      unstrain(x_start, start, w.start);
      if (w.by_shapes) {
        unshape(x, end, w);
        unshape(x_start, start, w);
        bear(x, g_.laws.stress(g_.strains()), w);
      }
    }
    for (int g = 0; g < g_.groups_; ++g) {
      if (r_.gel_blocks || w.by_elements) to_numbers(g, w);
      if (w.by_shapes) to_shapes(g, x, w);
      if (g_.damped_) to_rates(g, x_start, x_past, w);
    }
  }

 private:
  // Gradient of moves of the nodes at a point.
  Mat3 moved_at(const double *move, int e, int q) const {
    Mat3 out{};
    const double *b = r_.gel_gradient + (std::size_t(e) * points + q) * 3 * corners;
    for (int a = 0; a < corners; ++a)
      for (int i = 0; i < 3; ++i)
        for (int j = 0; j < 3; ++j) out(i, j) += move[3 * g_.node(e, a) + i] * b[3 * a + j];
    return out;
  }
  // The transpose, added.
  void spread(const double *gradient, int e, int q, double *out) const {
    const double *b = r_.gel_gradient + (std::size_t(e) * points + q) * 3 * corners;
    for (int a = 0; a < corners; ++a)
      for (int i = 0; i < 3; ++i)
        for (int j = 0; j < 3; ++j) out[3 * g_.node(e, a) + i] += gradient[3 * i + j] * b[3 * a + j];
  }
  // From weights of the strains at all points to those of the nodes.
  void unstrain(const double *x, const std::vector<double> &strain, std::vector<double> &out) const {
    for (int at = 0; at < points * g_.count_; ++at) {
      double m[9 * components], gradient[9] = {};
      Tetrahedra::by_gradient(g_.gradient_at(x, at / points, at % points), m);
      for (int c = 0; c < components; ++c)
        for (int k = 0; k < 9; ++k) gradient[k] += m[9 * c + k] * strain[std::size_t(components) * at + c];
      spread(gradient, at / points, at % points, out.data());
    }
  }

  Mat<Pack, 3, 3> moved_of(const double *move, int g, int q) const {
    Mat<Pack, 3, 3> out;
    for (int lane = 0; lane < Pack::size; ++lane) {
      const Mat3 one = moved_at(move, g_.element(g, lane), q);
      for (int k = 0; k < 9; ++k) out.a[k].a[lane] = one.a[k];
    }
    return out;
  }

  // By the numbers of the elements of a group.
  void to_numbers(int g, StepWeights &w) const {
    using D = Dual<Pack, 4>;
    const GelLaw<Pack> law = g_.law_of(g);
    const GelLaw<D> by = {{D::variable(law.number[0], 0), D::variable(law.number[1], 1), D::variable(law.number[2], 2)},
                          D::variable(law.rate, 3)};
    Pack work[5] = {Pack(0.0), Pack(0.0), Pack(0.0), Pack(0.0), Pack(0.0)};
    for (int q = 0; q < points; ++q) {
      const int p = points * g + q;
      const Mat<Pack, 3, 3> moved = moved_of(w.residual.data(), g, q);
      const Mat<D, 3, 3> stress = by.stress(g_.strain_[p], g_.theta_[p], g_.mean_[g], g_.base(p), g_.mean_base_[g]);
      for (int k = 0; k < 9; ++k) {
        const Pack along = g_.weight_[p] * moved.a[k];
        for (int n = 0; n < 4; ++n) work[n] += along * stress.a[k].d[n];
        work[FACTOR] += along * stress.a[k].v;
      }
    }
    work[BETA] = work[BETA] / Pack(g_.rates_.tau);
    for (int lane = 0; lane < g_.filled(g); ++lane) {
      const std::size_t e = Pack::size * g + lane;
      for (int n = 0; w.by_elements && n < 5; ++n) w.elements.gel[5 * e + n] += work[n].a[lane];
      for (int m = 0; m < r_.gel_blocks; ++m) {
        const double *slope = r_.d_gel + 5 * (std::size_t(m) * g_.count_ + e);
        for (int n = 0; n < 5; ++n) w.numbers[r_.gel_of[m]] += slope[n] * work[n].a[lane];
      }
    }
  }

  // By what rates are measured from.
  void to_rates(int g, const double *x_start, const double *x_past, StepWeights &w) const {
    using D = Dual<Pack, 8>;
    const GelLaw<Pack> law = g_.law_of(g);
    Pack base[points][7], mean(0.0);
    for (int q = 0; q < points; ++q) {
      const int p = points * g + q;
      D b[7];
      for (int k = 0; k < 7; ++k) b[k] = D::variable(g_.base(p)[k], k);
      const Mat<D, 3, 3> stress = law.stress(g_.strain_[p], g_.theta_[p], g_.mean_[g], b, D::variable(g_.mean_base_[g], 7));
      const Mat<Pack, 3, 3> moved = moved_of(w.residual.data(), g, q);
      for (Pack &k : base[q]) k = Pack(0.0);
      for (int i = 0; i < 9; ++i) {
        const Pack along = g_.weight_[p] * moved.a[i];
        for (int k = 0; k < 7; ++k) base[q][k] += along * stress.a[i].d[k];
        mean += along * stress.a[i].d[7];
      }
    }
    for (int q = 0; q < points; ++q) base[q][6] += g_.weight_[points * g + q] / g_.volume_[g] * mean;
    for (int lane = 0; lane < g_.filled(g); ++lane) {
      const int e = Pack::size * g + lane;
      if (g_.number(e, BETA) == 0.0) continue;
      for (int q = 0; q < points; ++q) {
        if (w.by_shapes)
          volume(e, q, w) += (mean / g_.volume_[g] * (g_.base(points * g + q)[6] - g_.mean_base_[g])).a[lane] * grown(e, w);
        double own[7];
        for (int k = 0; k < 7; ++k) own[k] = base[q][k].a[lane];
        unmeasure(x_start, e, q, own, g_.rates_.now, w.start.data(), w);
        if (x_past) unmeasure(x_past, e, q, own, g_.rates_.before, w.past.data(), w);
      }
    }
  }
  // From weights of the measures at a point to those of the nodes, times a number.
  void unmeasure(const double *x, int e, int q, const double *weight, double by, double *out, StepWeights &w) const {
    using D = Dual<double, 9>;
    const Mat3 g = g_.gradient_at(x, e, q);
    Mat<D, 3, 3> at;
    for (int k = 0; k < 9; ++k) at.a[k] = D::variable(g.a[k], k);
    D found[7];
    Tetrahedra::measures(at, found);
    double gradient[9] = {};
    for (int k = 0; k < 7; ++k)
      for (int i = 0; i < 9; ++i) gradient[i] += by * weight[k] * found[k].d[i];
    spread(gradient, e, q, out);
    shape(gradient, x, e, q, w);
  }

  // By gradients of the shape functions and volumes, of what elements of a group exert at the end of a step.
  void to_shapes(int g, const double *x, StepWeights &w) const {
    const GelLaw<Pack> law = g_.law_of(g);
    Mat<Pack, 3, 3> ends[points], widen[points], stress[points], moved[points];
    Pack mean(0.0);
    for (int q = 0; q < points; ++q) {
      const int p = points * g + q;
      Pack tangent[81];
      g_.differentiate(p, g, law, true, tangent, widen[q]);
      moved[q] = moved_of(w.residual.data(), g, q);
      stress[q] = law.stress(g_.strain_[p], g_.theta_[p], g_.mean_[g], g_.base(p), g_.mean_base_[g]);
      for (int k = 0; k < 9; ++k) {
        ends[q].a[k] = Pack(0.0);
        for (int m = 0; m < 9; ++m) ends[q].a[k] += g_.weight_[p] * moved[q].a[m] * tangent[9 * m + k];
        mean += g_.weight_[p] * (1.0 + law.rate) * law.number[MEAN] * widen[q].a[k] * moved[q].a[k];
      }
    }
    for (int q = 0; q < points; ++q) {
      const int p = points * g + q;
      Pack work = mean / g_.volume_[g] * (g_.theta_[p] - g_.mean_[g]);
      for (int k = 0; k < 9; ++k) {
        ends[q].a[k] += mean * g_.weight_[p] / g_.volume_[g] * widen[q].a[k];
        work += stress[q].a[k] * moved[q].a[k];
      }
      for (int lane = 0; lane < g_.filled(g); ++lane) {
        const int e = Pack::size * g + lane;
        double by_end[9], by_move[9];
        for (int k = 0; k < 9; ++k) {
          by_end[k] = ends[q].a[k].a[lane];
          by_move[k] = (g_.weight_[p] * stress[q].a[k]).a[lane];
        }
        shape(by_end, x, e, q, w);
        shape(by_move, w.residual.data(), e, q, w);
        volume(e, q, w) += work.a[lane] * grown(e, w);
      }
    }
  }
  // The same of laws, with their stresses times volumes (points, 6), on their moves.
  void bear(const double *x, const double *stresses, StepWeights &w) const {
    for (int at = 0; at < points * g_.count_; ++at) {
      const double *s = stresses + components * at;
      const Mat3 borne = {{s[0], s[5], s[4], s[5], s[1], s[3], s[4], s[3], s[2]}};
      const Mat3 by_end = matmul(moved_at(w.residual.data(), at / points, at % points), borne);
      Mat3 f = g_.gradient_now(at);
      for (int i = 0; i < 3; ++i) f(i, i) += 1.0;
      const Mat3 by_move = matmul(f, borne);
      shape(by_end.a, x, at / points, at % points, w);
      shape(by_move.a, w.residual.data(), at / points, at % points, w);
    }
  }
  // From weights of the strains at all points to those of the gradients of the shape functions.
  void unshape(const double *x, const std::vector<double> &strain, StepWeights &w) const {
    for (int at = 0; at < points * g_.count_; ++at) {
      double m[9 * components], gradient[9] = {};
      Tetrahedra::by_gradient(g_.gradient_at(x, at / points, at % points), m);
      for (int c = 0; c < components; ++c)
        for (int k = 0; k < 9; ++k) gradient[k] += m[9 * c + k] * strain[std::size_t(components) * at + c];
      shape(gradient, x, at / points, at % points, w);
    }
  }
  // From weights of a gradient at a point, of nodes at `x`, to those of the gradients of the shape functions, added. With
  // the shape at rest the gradient of its own positions stays 1.
  void shape(const double *gradient, const double *x, int e, int q, StepWeights &w) const {
    if (!w.by_shapes) return;
    double *to = &w.elements.gel_gradient[(std::size_t(e) * points + q) * 3 * corners];
    for (int a = 0; a < corners; ++a)
      for (int i = 0; i < 3; ++i)
        for (int j = 0; j < 3; ++j) to[3 * a + j] += gradient[3 * i + j] * x[3 * g_.node(e, a) + i];
  }
  double &volume(int e, int q, StepWeights &w) const { return w.elements.gel_volume[points * std::size_t(e) + q]; }
  static double grown(int e, const StepWeights &w) { return w.gradings->growth(int(Strained::SOLID), e); }

  Tetrahedra &g_;
  const Record &r_;
};

}  // namespace thinshell
