// Quadratic tetrahedra of a compressible neo-Hookean gel, with damping by the rate of strain (Kelvin-Voigt).
//
// At four points of each, of volume w and with the displacement gradient G (sim_core/energies/neo_hookean.py):
//
//     E = sum_q w [W(G; (1 + k) mu) + p/2 theta] - k [mu S_b : C/2 + (K_own theta_b + K_mean mean theta_b) theta]
//     p = (1 + k) (K_own theta + K_mean mean theta),   theta = J - 1,   k = beta / tau
//
// S_b, theta_b: S_dev / mu and J - 1 from which rates are measured. Energy and stress are laws of a point; the tangent by
// G and the derivatives by mu, K_own, K_mean, k and by what rates are measured from are those of dual numbers. The mean is
// that of one element and adds K_mean / V v v^T to its Hessian, v = d(V mean theta)/dx.
//
// Material laws of effects (strain_laws.hpp) see Green's strain E (11, 22, 33, twice 23, 13, 12) of a point, and add the
// stress S to P = F S; with M = dE/dG, that is P = M^T S, and the tangent M^T C M + S . dM/dG.
#pragma once

#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include "elements.hpp"

namespace thinshell {

// Places of the numbers of an element.
enum GelNumber { SHEAR, OWN, MEAN, BETA, FACTOR };

// Stress and pressures with the numbers of elements; S: their scalar, dual for derivatives by them.
template <class S> struct GelLaw {
  S number[3], rate;  // mu, K_own, K_mean [Pa]; k

  S shear() const { return (1.0 + rate) * number[SHEAR]; }
  template <class T> Common<S, T> pressure(const T &theta, const Pack &mean) const {
    return (1.0 + rate) * number[OWN] * theta + (1.0 + rate) * number[MEAN] * mean;
  }
  template <class T> Common<S, T> damped_pressure(const T &theta, const T &mean) const {
    return -(rate * number[OWN]) * theta - rate * number[MEAN] * mean;
  }
  // Of the stress S_b (11, 22, 33, 23, 13, 12).
  template <class T> Mat<Common<S, T>, 3, 3> memory(const T *b) const {
    const S by = -(rate * number[SHEAR]);
    return {{by * b[0], by * b[5], by * b[4], by * b[5], by * b[1], by * b[3], by * b[4], by * b[3], by * b[2]}};
  }
  template <class G, class T, class B>
  Mat<Common<S, G, B>, 3, 3> stress(const Mat<G, 3, 3> &g, const T &theta, const Pack &mean, const B *b,
                                    const B &mean_base) const {
    return laws::neo_hookean_kernels::first_piola(
        g, shear(), pressure(theta, mean) + damped_pressure(b[6], mean_base), memory(b));
  }
};

class Tetrahedra {
 public:
  static constexpr int corners = 10, points = 4, pairs = corners * (corners + 1) / 2;

  explicit Tetrahedra(const Record &record)
      : laws(record, Strained::SOLID, points * int(record.tetrahedra)), r_(record), count_(int(record.tetrahedra)), groups_((count_ + Pack::size - 1) / Pack::size) {
    for (int e = 0; e < count_; ++e) damped_ = damped_ || number(e, BETA) != 0.0;
    for (int64_t k = 0; k < r_.gel_blocks * count_; ++k) damped_ = damped_ || r_.d_gel[5 * k + BETA] != 0.0;
    grad_.assign(std::size_t(groups_) * points * 3 * corners, Pack(0.0));
    weight_.assign(std::size_t(groups_) * points, Pack(0.0));
    number_.assign(std::size_t(groups_) * 4, Pack(0.0));
    volume_.assign(groups_, Pack(0.0));
    for (int g = 0; g < groups_; ++g)
      for (int lane = 0; lane < Pack::size; ++lane) {
        const int e = element(g, lane);
        for (int k = 0; k < points * 3 * corners; ++k)
          grad_[std::size_t(g) * points * 3 * corners + k].a[lane] = r_.gel_gradient[std::size_t(e) * points * 3 * corners + k];
        for (int n = 0; n < 4; ++n) number_[4 * g + n].a[lane] = number(e, n);
      }
    weigh();
    strain_.assign(std::size_t(groups_) * points, Mat<Pack, 3, 3>{});
    theta_.assign(std::size_t(groups_) * points, Pack(0.0));
    mean_.assign(groups_, Pack(0.0));
    base_.assign(std::size_t(groups_) * points * 7, Pack(0.0));
    mean_base_.assign(groups_, Pack(0.0));
    seen_.assign(3 * r_.nodes, std::numeric_limits<double>::quiet_NaN());
    slope_now_.assign(damped_ ? std::size_t(count_) * points * 7 * r_.columns : 0, 0.0);
    slope_past_ = slope_now_;
    moved_.assign(laws.any() ? std::size_t(count_) * points * components * r_.columns : 0, 0.0);
  }

  static constexpr int components = 6;
  StrainLaws<components> laws;

  bool any() const { return count_ > 0; }

  // Take the volumes of the record, which change with the factor of the modulus.
  void weigh() {
    for (int g = 0; g < groups_; ++g) {
      volume_[g] = Pack(0.0);
      for (int lane = 0; lane < Pack::size; ++lane)
        for (int q = 0; q < points; ++q) {
          const double w = r_.gel_volume[points * element(g, lane) + q];
          weight_[points * g + q].a[lane] = w;
          volume_[g].a[lane] += w;
        }
    }
  }

  void couple(Blocks &h) const {
    for (int e = 0; e < count_; ++e)
      for (int a = 0; a < corners; ++a)
        for (int b = a; b < corners; ++b) h.couple(node(e, a), node(e, b));
  }
  void bind(const Blocks &h) {
    slots_.clear();
    for (int e = 0; e < count_; ++e)
      for (int a = 0; a < corners; ++a)
        for (int b = a; b < corners; ++b) slots_.push_back(h.slot(node(e, a), node(e, b)));
  }

  void begin(const double *x_start, const double *x_past, const Rates &rates) {
    rates_ = rates;
    laws.begin([&](int p, double *e) { strain_of(gradient_at(x_start, p / points, p % points), e); }, rates.dt);
    if (!damped_) return;
    for (int g = 0; g < groups_; ++g) {
      Pack total(0.0);
      for (int q = 0; q < points; ++q) {
        for (int lane = 0; lane < Pack::size; ++lane) {
          const int e = element(g, lane);
          double found[7];
          measures(gradient_at(x_start, e, q), found);
          for (double &f : found) f *= rates.now;
          if (x_past) {
            double before[7];
            measures(gradient_at(x_past, e, q), before);
            for (int k = 0; k < 7; ++k) found[k] += rates.before * before[k];
          }
          for (int k = 0; k < 7; ++k) base_[(points * g + q) * 7 + k].a[lane] = found[k];
        }
        total += weight_[points * g + q] * base_[(points * g + q) * 7 + 6];
      }
      mean_base_[g] = total / volume_[g];
    }
  }

  double energy(const double *x) {
    measure(x);
    double out = laws.energy(strains());
    for (int g = 0; g < groups_; ++g) {
      const Law<Pack> law = law_of(g);
      Pack total(0.0);
      for (int q = 0; q < points; ++q) {
        const int p = points * g + q;
        const Pack pressure = 0.5 * law.pressure(theta_[p], mean_[g]) + law.damped_pressure(base(p)[6], mean_base_[g]);
        total += weight_[p] * laws::neo_hookean_kernels::energy_density(strain_[p], law.shear(), pressure,
                                                                        law.memory(base(p)));
      }
      for (int lane = 0; lane < filled(g); ++lane) out += total.a[lane];
    }
    return out;
  }

  // What `energy` has of the damping where the step starts, where that has dissipated nothing.
  double damping_at_start(const double *x_start) {
    if (!damped_) return 0.0;
    const double whole = energy(x_start), tau = rates_.tau;
    rates_.tau = std::numeric_limits<double>::infinity();
    const double elastic = energy(x_start);
    rates_.tau = tau;
    return whole - elastic;
  }

  void add_gradient(const double *x, double *out) {
    measure(x);
    if (laws.any()) bear(laws.stress(strains()), out);
    for (int g = 0; g < groups_; ++g) {
      const Law<Pack> law = law_of(g);
      Pack force[3 * corners];
      for (Pack &f : force) f = Pack(0.0);
      for (int q = 0; q < points; ++q) {
        const int p = points * g + q;
        push(p, law.stress(strain_[p], theta_[p], mean_[g], base(p), mean_base_[g]), force);
      }
      for (int lane = 0; lane < filled(g); ++lane)
        for (int a = 0; a < corners; ++a)
          for (int i = 0; i < 3; ++i) out[3 * node(4 * g + lane, a) + i] += force[3 * a + i].a[lane];
    }
  }

  // Without `exact` each point is made semidefinite.
  void add_hessian(const double *x, bool exact, Blocks &h) {
    measure(x);
    if (!exact) project();
    added_ = laws.any() ? laws.tangent(strains(), exact, false) : nullptr;
    std::vector<Pack> local(9 * pairs), columns(27 * corners);
    for (int g = 0; g < groups_; ++g) {
      const Law<Pack> law = law_of(g);
      std::fill(local.begin(), local.end(), Pack(0.0));
      Pack swell[3 * corners];
      for (Pack &s : swell) s = Pack(0.0);
      for (int q = 0; q < points; ++q) {
        const int p = points * g + q;
        Pack tangent[81];
        Mat<Pack, 3, 3> widen;
        differentiate(p, g, law, exact, tangent, widen);
        if (added_) add_laws(p, g, exact, tangent);
        push(p, widen, swell);
        add_point(p, tangent, columns.data(), local.data());
      }
      const Pack mean = law.number[MEAN] * (1.0 + law.rate) / volume_[g];
      Pack *to = local.data();
      for (int a = 0; a < corners; ++a)
        for (int b = a; b < corners; ++b, to += 9)
          for (int i = 0; i < 3; ++i)
            for (int k = 0; k < 3; ++k) to[3 * i + k] += mean * swell[3 * a + i] * swell[3 * b + k];
      for (int lane = 0; lane < filled(g); ++lane)
        for (int k = 0; k < pairs; ++k) {
          Mat3 block;
          for (int c = 0; c < 9; ++c) block.a[c] = local[9 * k + c].a[lane];
          h.add(slots_[std::size_t(4 * g + lane) * pairs + k], block);
        }
    }
  }

  // Whether some volume is gone at a point on the straight way of the nodes to `after` (nodes, 3).
  bool turns_over(const double *before, const double *after) const {
    for (int e = 0; e < count_; ++e)
      for (int q = 0; q < points; ++q)
        if (!(least_volume(gradient_at(before, e, q), gradient_at(after, e, q)) > 0.0)) return true;
    return false;
  }

  void end(const double *x) {
    if (!laws.any()) return;
    measure(x);
    laws.end(strains());
  }

  void keep_slopes(const double *x, const double *dx) {
    if (laws.any()) {
      measure(x);
      measure_strains(x, dx);
      laws.end_columns(strains(), moved_);
    }
    if (!damped_) return;
    slope_past_.swap(slope_now_);
    measure_slopes(x, dx);
  }
  void restart_slopes(const double *x, const double *dx) {
    if (damped_) measure_slopes(x, dx);
    if (!laws.any()) return;
    measure_strains(x, dx);
    laws.restart(moved_);
  }

  // What forces change by at held positions, into (nodes, 3, columns).
  void add_columns(const double *x, double *out) {
    const int width = int(r_.columns);
    if (!damped_ && !r_.gel_blocks && !laws.any()) return;
    measure(x);
    if (laws.any()) {
      std::vector<double> stress(moved_.size(), 0.0);
      laws.add_columns(strains(), stress.data());
      bear(stress.data(), out, width);
    }
    for (int g = 0; g < groups_; ++g) {
      if (r_.gel_blocks) add_numbers(g, out);
      if (damped_)
        for (int lane = 0; lane < filled(g); ++lane) add_rates(g, lane, width, out);
    }
  }

 private:
  template <class> friend struct Pull;
  template <class S> using Law = GelLaw<S>;

  Law<Pack> law_of(int g) const {
    const Pack *n = &number_[4 * g];
    return {{n[SHEAR], n[OWN], n[MEAN]}, n[BETA] / Pack(rates_.tau)};
  }

  int element(int g, int lane) const { return std::min(Pack::size * g + lane, count_ - 1); }
  int filled(int g) const { return std::min(Pack::size, count_ - Pack::size * g); }
  int node(int e, int a) const { return r_.tetrahedron[corners * e + a]; }
  double number(int e, int n) const { return r_.gel_number[4 * e + n]; }
  const Pack *base(int p) const { return &base_[7 * p]; }
  const Pack *gradients(int p) const { return &grad_[std::size_t(p) * 3 * corners]; }

  Mat3 gradient_at(const double *x, int e, int q) const {
    Mat3 g{};
    const double *b = r_.gel_gradient + (std::size_t(e) * points + q) * 3 * corners;
    for (int a = 0; a < corners; ++a)
      for (int i = 0; i < 3; ++i) {
        const int at = 3 * node(e, a) + i;
        for (int j = 0; j < 3; ++j) g(i, j) += (x[at] - r_.rest[at]) * b[3 * a + j];
      }
    return g;
  }

  template <class T> static T theta_of(const Mat<T, 3, 3> &g) { return g.trace() + laws::neo_hookean_kernels::_bilinear(g); }

  // Components of Green's strain.
  static constexpr int first_axis[components] = {0, 1, 2, 1, 0, 0}, second_axis[components] = {0, 1, 2, 2, 2, 1};
  static void strain_of(const Mat3 &g, double *e) {
    for (int c = 0; c < components; ++c) {
      const int a = first_axis[c], b = second_axis[c];
      double found = g(a, b) + g(b, a);
      for (int k = 0; k < 3; ++k) found += g(k, a) * g(k, b);
      e[c] = c < 3 ? 0.5 * found : found;
    }
  }
  // What laws see: the strains at a point, 4 e + q.
  struct Strains {
    const Tetrahedra &of;
    void operator()(int at, double *e) const { strain_of(of.gradient_now(at), e); }
  };
  Strains strains() const { return {*this}; }
  Mat3 gradient_now(int at) const {
    const int e = at / points, p = points * (e / Pack::size) + at % points;
    Mat3 g;
    for (int k = 0; k < 9; ++k) g.a[k] = strain_[p].a[k].a[e % Pack::size];
    return g;
  }
  // M = dE/dG (6, 9).
  static void by_gradient(const Mat3 &g, double *m) {
    std::fill(m, m + 9 * components, 0.0);
    for (int c = 0; c < components; ++c)
      for (int k = 0; k < 3; ++k) {
        const int a = first_axis[c], b = second_axis[c];
        m[9 * c + 3 * k + b] += g(k, a) + (k == a);
        if (c >= 3) m[9 * c + 3 * k + a] += g(k, b) + (k == b);
      }
  }

  // Add the forces of stresses times volumes (points, 6, columns) to (nodes, 3, columns).
  void bear(const double *stress, double *out, int columns = 1) const {
    std::vector<double> piola(std::size_t(9) * columns);
    for (int at = 0; at < points * count_; ++at) {
      double m[9 * components];
      by_gradient(gradient_now(at), m);
      std::fill(piola.begin(), piola.end(), 0.0);
      for (int c = 0; c < components; ++c)
        for (int k = 0; k < 9; ++k) {
          const double *from = stress + (std::size_t(components) * at + c) * columns;
          for (int l = 0; l < columns; ++l) piola[k * columns + l] += m[9 * c + k] * from[l];
        }
      const double *b = r_.gel_gradient + std::size_t(at) * 3 * corners;
      for (int a = 0; a < corners; ++a)
        for (int i = 0; i < 3; ++i) {
          double *to = out + (3 * std::size_t(node(at / points, a)) + i) * columns;
          for (int j = 0; j < 3; ++j)
            for (int l = 0; l < columns; ++l) to[l] += b[3 * a + j] * piola[(3 * i + j) * columns + l];
        }
    }
  }
  // Add what laws make of the tangent of a point, per volume as all of it. Without `exact` their tension alone.
  void add_laws(int p, int g, bool exact, Pack *tangent) const {
    for (int lane = 0; lane < filled(g); ++lane) {
      const int at = points * (Pack::size * g + lane) + p % points;
      const double *c = added_ + components * components * at, *s = laws.stresses() + components * at;
      const double volume = weight_[p].a[lane];
      double m[9 * components], left[9 * components] = {}, borne[9] = {s[0], s[5], s[4], s[5], s[1], s[3], s[4], s[3], s[2]};
      by_gradient(gradient_now(at), m);
      if (!exact) make_semidefinite<3>(borne);
      for (int i = 0; i < components; ++i)
        for (int j = 0; j < components; ++j)
          for (int k = 0; k < 9; ++k) left[9 * i + k] += c[components * i + j] * m[9 * j + k];
      for (int r = 0; r < 9; ++r)
        for (int k = 0; k < 9; ++k) {
          double total = r / 3 == k / 3 ? borne[3 * (r % 3) + k % 3] : 0.0;
          for (int i = 0; i < components; ++i) total += m[9 * i + r] * left[9 * i + k];
          tangent[9 * r + k].a[lane] += total / volume;
        }
    }
  }
  // Derivatives of the strains at all points, from those of the positions.
  void measure_strains(const double *x, const double *dx) {
    const int width = int(r_.columns);
    std::fill(moved_.begin(), moved_.end(), 0.0);
    std::vector<double> turned(std::size_t(9) * width);
    for (int at = 0; at < points * count_; ++at) {
      double m[9 * components];
      by_gradient(gradient_at(x, at / points, at % points), m);
      gradient_slopes(dx, at / points, at % points, turned);
      for (int c = 0; c < components; ++c)
        for (int k = 0; k < 9; ++k)
          for (int l = 0; l < width; ++l)
            moved_[(std::size_t(components) * at + c) * width + l] += m[9 * c + k] * turned[k * width + l];
    }
  }
  // Derivatives of G at a point (9, columns).
  void gradient_slopes(const double *dx, int e, int q, std::vector<double> &out) const {
    const int width = int(r_.columns);
    std::fill(out.begin(), out.end(), 0.0);
    const double *b = r_.gel_gradient + (std::size_t(e) * points + q) * 3 * corners;
    for (int a = 0; a < corners; ++a)
      for (int i = 0; i < 3; ++i) {
        const double *from = dx + (3 * std::size_t(node(e, a)) + i) * width;
        for (int j = 0; j < 3; ++j)
          for (int c = 0; c < width; ++c) out[(3 * i + j) * width + c] += b[3 * a + j] * from[c];
      }
  }

  // S_dev / mu (11, 22, 33, 23, 13, 12) and J - 1.
  template <class T> static void measures(const Mat<T, 3, 3> &g, T *out) {
    const auto s = laws::neo_hookean_kernels::deviatoric(g);
    const T found[7] = {s(0, 0), s(1, 1), s(2, 2), s(1, 2), s(0, 2), s(0, 1), theta_of(g)};
    std::copy(found, found + 7, out);
  }

  void measure(const double *x) {
    if (std::equal(seen_.begin(), seen_.end(), x)) return;
    std::copy(x, x + seen_.size(), seen_.begin());
    for (int g = 0; g < groups_; ++g) {
      Pack u[3 * corners], total(0.0);
      for (int lane = 0; lane < Pack::size; ++lane)
        for (int a = 0; a < corners; ++a)
          for (int i = 0; i < 3; ++i) {
            const int at = 3 * node(element(g, lane), a) + i;
            u[3 * a + i].a[lane] = x[at] - r_.rest[at];
          }
      for (int q = 0; q < points; ++q) {
        const int p = points * g + q;
        const Pack *b = gradients(p);
        Mat<Pack, 3, 3> found;
        for (int k = 0; k < 9; ++k) found.a[k] = Pack(0.0);
        for (int a = 0; a < corners; ++a)
          for (int i = 0; i < 3; ++i)
            for (int j = 0; j < 3; ++j) found(i, j) += u[3 * a + i] * b[3 * a + j];
        strain_[p] = found;
        theta_[p] = theta_of(found);
        total += weight_[p] * theta_[p];
      }
      mean_[g] = total / volume_[g];
    }
  }

  // Add w B^T stress of a point to the forces of the nodes.
  void push(int p, const Mat<Pack, 3, 3> &stress, Pack *force) const {
    const Pack *b = gradients(p);
    const Mat<Pack, 3, 3> s = weight_[p] * stress;
    for (int a = 0; a < corners; ++a)
      for (int i = 0; i < 3; ++i)
        force[3 * a + i] += s(i, 0) * b[3 * a] + s(i, 1) * b[3 * a + 1] + s(i, 2) * b[3 * a + 2];
  }

  // Tangent of a point, of all but the mean, and cof F.
  void differentiate(int p, int g, const Law<Pack> &law, bool exact, Pack *tangent, Mat<Pack, 3, 3> &widen) const {
    using D = Dual<Pack, 9>;
    Mat<D, 3, 3> at;
    for (int k = 0; k < 9; ++k) at.a[k] = D::variable(strain_[p].a[k], k);
    const D theta = theta_of(at);
    for (int k = 0; k < 9; ++k) widen.a[k] = theta.d[k];
    if (!exact) {
      for (int lane = 0; lane < Pack::size; ++lane)
        for (int k = 0; k < 81; ++k)
          tangent[k].a[lane] = projected_[(std::size_t(points) * element(g, lane) + p % points) * 81 + k];
      return;
    }
    const Mat<D, 3, 3> stress = law.stress(at, theta, mean_[g], base(p), mean_base_[g]);
    for (int k = 0; k < 9; ++k)
      for (int m = 0; m < 9; ++m) tangent[9 * k + m] = stress.a[k].d[m];
  }

  // Add w B^T tangent B of a point to the blocks of an element; columns: room for tangent B.
  void add_point(int p, const Pack *tangent, Pack *columns, Pack *local) const {
    const Pack *b = gradients(p);
    for (int d = 0; d < corners; ++d) {
      const Pack u = weight_[p] * b[3 * d], v = weight_[p] * b[3 * d + 1], w = weight_[p] * b[3 * d + 2];
      for (int r = 0; r < 9; ++r)
        for (int k = 0; k < 3; ++k) {
          const Pack *row = tangent + 9 * r + 3 * k;
          columns[27 * d + 3 * r + k] = u * row[0] + v * row[1] + w * row[2];
        }
    }
    for (int a = 0; a < corners; ++a) {
      const Pack u = b[3 * a], v = b[3 * a + 1], w = b[3 * a + 2];
      for (int d = a; d < corners; ++d, local += 9) {
        const Pack *from = columns + 27 * d;
        for (int i = 0; i < 3; ++i)
          for (int k = 0; k < 3; ++k)
            local[3 * i + k] += u * from[9 * i + k] + v * from[9 * i + 3 + k] + w * from[9 * i + 6 + k];
      }
    }
  }

  // Semidefinite tangents of all points (element, point, 9, 9).
  void project() {
    projected_.resize(std::size_t(count_) * points * 81);
    for (int e = 0; e < count_; ++e) {
      const int g = e / Pack::size, lane = e % Pack::size;
      const double k = number(e, BETA) / rates_.tau, bulk = number(e, OWN) + number(e, MEAN);
      double strain[9 * points], dilatation[points], history[7 * points], modes[90];
      double moduli[3] = {number(e, SHEAR), bulk, number(e, OWN) / bulk}, constants[3] = {1.0 + k, 1.0 + k, k};
      auto mixed = [&](double own, double mean) { return moduli[2] * own + (1.0 - moduli[2]) * mean; };
      for (int q = 0; q < points; ++q) {
        const int p = points * g + q;
        for (int c = 0; c < 9; ++c) strain[9 * q + c] = strain_[p].a[c].a[lane];
        dilatation[q] = mixed(theta_[p].a[lane], mean_[g].a[lane]);
        for (int c = 0; c < 6; ++c) history[7 * q + c] = -k * moduli[0] * base(p)[c].a[lane];
        history[7 * q + 6] = -k * bulk * mixed(base(p)[6].a[lane], mean_base_[g].a[lane]);
      }
      laws::neo_hookean_kernels::projected_tangent(
          View<double, 3>(strain, points, 3, 3), View<double, 1>(dilatation, points), View<double, 2>(history, points, 7),
          View<double, 2>(moduli, 1, 3), View<double, 2>(constants, 1, 3), View<double, 2>(modes, 9, 10),
          View<double, 3>(&projected_[std::size_t(e) * points * 81], points, 9, 9));
    }
  }

  static double least_volume(const Mat3 &start, const Mat3 &end) {
    const Mat3 one = {{1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0}}, f = one + start, d = end - start;
    const double c0 = f.determinant(), c3 = d.determinant();
    const double c1 = laws::neo_hookean_kernels::_cofactor(f).dot(d), c2 = laws::neo_hookean_kernels::_cofactor(d).dot(f);
    double least = std::min(c0, c0 + c1 + c2 + c3);
    const double root = std::sqrt(c2 * c2 - 3.0 * c1 * c3), middle = -(c2 + (c2 < 0.0 ? -root : root));
    for (const double s : {middle / (3.0 * c3), c1 / middle})
      if (s > 0.0 && s < 1.0) least = std::min(least, c0 + s * (c1 + s * (c2 + s * c3)));
    return least;
  }

  // By the numbers of the elements of a group.
  void add_numbers(int g, double *out) const {
    using D = Dual<Pack, 4>;
    const Law<Pack> law = law_of(g);
    const Law<D> by = {{D::variable(law.number[0], 0), D::variable(law.number[1], 1), D::variable(law.number[2], 2)},
                       D::variable(law.rate, 3)};
    Pack force[5][3 * corners];
    for (auto &f : force)
      for (Pack &k : f) k = Pack(0.0);
    for (int q = 0; q < points; ++q) {
      const int p = points * g + q;
      const Mat<D, 3, 3> stress = by.stress(strain_[p], theta_[p], mean_[g], base(p), mean_base_[g]);
      for (int n = 0; n < 5; ++n) {
        Mat<Pack, 3, 3> part;
        for (int k = 0; k < 9; ++k) part.a[k] = n == FACTOR ? stress.a[k].v : stress.a[k].d[n];
        push(p, n == BETA ? Mat<Pack, 3, 3>(part / Pack(rates_.tau)) : part, force[n]);
      }
    }
    for (int lane = 0; lane < filled(g); ++lane) {
      const int e = Pack::size * g + lane;
      for (int m = 0; m < r_.gel_blocks; ++m) {
        const double *slope = r_.d_gel + 5 * (std::size_t(m) * count_ + e);
        for (int c = 0; c < 3 * corners; ++c) {
          double total = 0.0;
          for (int n = 0; n < 5; ++n) total += slope[n] * force[n][c].a[lane];
          out[(3 * std::size_t(node(e, c / 3)) + c % 3) * r_.columns + r_.gel_of[m]] += total;
        }
      }
    }
  }

  // By what rates are measured from, of one element.
  void add_rates(int g, int lane, int width, double *out) const {
    const int e = Pack::size * g + lane;
    if (number(e, BETA) == 0.0) return;
    using D = Dual<Pack, 8>;
    const Law<Pack> law = law_of(g);
    std::vector<double> mean(width, 0.0), change(std::size_t(7) * width), pushed(std::size_t(9) * width);
    auto based = [&](int q, int k, int c) {
      const std::size_t at = ((std::size_t(e) * points + q) * 7 + k) * width + c;
      return rates_.now * slope_now_[at] + rates_.before * slope_past_[at];
    };
    for (int q = 0; q < points; ++q)
      for (int c = 0; c < width; ++c)
        mean[c] += weight_[points * g + q].a[lane] / volume_[g].a[lane] * based(q, 6, c);
    for (int q = 0; q < points; ++q) {
      const int p = points * g + q;
      D b[7];
      for (int k = 0; k < 7; ++k) b[k] = D::variable(base(p)[k], k);
      const Mat<D, 3, 3> stress = law.stress(strain_[p], theta_[p], mean_[g], b, D::variable(mean_base_[g], 7));
      std::fill(pushed.begin(), pushed.end(), 0.0);
      for (int k = 0; k < 8; ++k)
        for (int c = 0; c < width; ++c) {
          const double by = weight_[p].a[lane] * (k < 7 ? based(q, k, c) : mean[c]);
          for (int i = 0; i < 9; ++i) pushed[i * width + c] += stress.a[i].d[k].a[lane] * by;
        }
      const Pack *grad = gradients(p);
      for (int a = 0; a < corners; ++a)
        for (int i = 0; i < 3; ++i) {
          double *to = out + (3 * std::size_t(node(e, a)) + i) * width;
          for (int j = 0; j < 3; ++j) {
            const double by = grad[3 * a + j].a[lane];
            for (int c = 0; c < width; ++c) to[c] += by * pushed[(3 * i + j) * width + c];
          }
        }
    }
  }

  // Derivatives of the measures at all points, from those of the positions (nodes, 3, columns).
  void measure_slopes(const double *x, const double *dx) {
    using D = Dual<double, 9>;
    const int width = int(r_.columns);
    std::vector<double> moved(std::size_t(9) * width);
    for (int e = 0; e < count_; ++e)
      for (int q = 0; q < points; ++q) {
        const Mat3 g = gradient_at(x, e, q);
        Mat<D, 3, 3> at;
        for (int k = 0; k < 9; ++k) at.a[k] = D::variable(g.a[k], k);
        D found[7];
        measures(at, found);
        gradient_slopes(dx, e, q, moved);
        double *to = &slope_now_[(std::size_t(e) * points + q) * 7 * width];
        for (int k = 0; k < 7; ++k, to += width) {
          std::fill(to, to + width, 0.0);
          for (int i = 0; i < 9; ++i)
            for (int c = 0; c < width; ++c) to[c] += found[k].d[i] * moved[i * width + c];
        }
      }
  }

  const Record &r_;
  int count_, groups_;
  bool damped_ = false;
  Rates rates_{1.0, 0.0, 1.0, 1.0};
  std::vector<Pack> grad_, weight_, number_, volume_;      // of groups of elements, points innermost but components
  std::vector<Mat<Pack, 3, 3>> strain_;                     // G of the points
  std::vector<Pack> theta_, mean_, base_, mean_base_;
  std::vector<double> seen_, slope_now_, slope_past_, projected_, moved_;
  const double *added_ = nullptr;  // tangents of laws at the last Hessian
  std::vector<Slot> slots_;
};

}  // namespace thinshell
