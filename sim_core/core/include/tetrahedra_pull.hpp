// Gels on the way back (elements_pull.hpp).
#pragma once

#include "strain_laws_pull.hpp"
#include "tetrahedra.hpp"

namespace thinshell {

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
