// A material law at one point, with derivatives: what a law of sim_core/core/material.py is compiled with.
//
// The law is the incremental energy w of a step and the new internal variables, from the strain at its end and at its
// start, the stiffness D of the body's own law, the internal variables, the length of the step and the numbers of the
// effect; these stand in a row of numbers in that order, what it adds in another: w, stress dw/de, tangent d2w/de2.
#pragma once

#include "lanes.hpp"
#include "pack.hpp"

namespace thinshell {

template <class D, int R, int C = 1> Mat<D, R, C> taken(const D *x) {
  Mat<D, R, C> out;
  for (int i = 0; i < R * C; ++i) out.a[i] = x[i];
  return out;
}

template <class D, class U> void give(const U &value, D *&to) { *to++ = D(value); }
template <class D, class U, int R, int C> void give(const Mat<U, R, C> &value, D *&to) {
  for (int i = 0; i < R * C; ++i) *to++ = D(value.a[i]);
}

// `Point`: K strains, how many `inputs` and internal variables `states` there are, and the law itself,
// template <class D, class T> static void law(const D *e, const T *in, D *out), e: strains, out: w and the new internal
// variables; and template <class R, class D, class T> static R energy(const D *e, const T *in), w alone. `Number`: Pack where it has no branches, else double.
// What these functions call is put into them, so that of the new internal variables nothing is worked out for w alone.
template <class Point> struct MaterialPoint {
  static constexpr int K = Point::K, inputs = Point::inputs, states = Point::states;
  using Number = typename Point::Number;
  static constexpr int size = Same<Number, Pack>::value ? Pack::size : 1;

  static double part(double x, int) { return x; }
  static double part(const Pack &x, int lane) { return x.a[lane]; }
  static void set(double &x, int, double value) { x = value; }
  static void set(Pack &x, int lane, double value) { x.a[lane] = value; }

  // Take n points a few at once: what `found(x, row)` makes of theirs x (inputs) in `row`, `width` numbers each.
  template <int width, class F> __attribute__((flatten)) static void each(long n, const double *in, double *out, F &&found) {
    Number x[inputs], row[width > 0 ? width : 1];
    for (long first = 0; first < n; first += size) {
      const int some = int(n - first < size ? n - first : size);
      for (int lane = 0; lane < size; ++lane) {
        const double *own = in + (first + (lane < some ? lane : 0)) * inputs;
        for (int i = 0; i < inputs; ++i) set(x[i], lane, own[i]);
      }
      found(x, row);
      for (int lane = 0; lane < some; ++lane)
        for (int i = 0; i < width; ++i) *out++ = part(row[i], lane);
    }
  }

  // w and stress of n points.
  static void stress(long n, const double *in, double *out) {
    each<1 + K>(n, in, out, [](const Number *x, Number *row) {
      using D = Dual<Number, K>;
      D e[K];
      for (int i = 0; i < K; ++i) e[i] = D::variable(x[i], i);
      const D found = Point::template energy<D>(e, x);
      row[0] = found.v;
      for (int i = 0; i < K; ++i) row[1 + i] = found.d[i];
    });
  }

  // w, stress and tangent.
  static void respond(long n, const double *in, double *out) {
    each<1 + K + K * K>(n, in, out, [](const Number *x, Number *row) {
      using D = Dual2<Number, K>;
      D e[K];
      for (int i = 0; i < K; ++i) e[i] = D::variable(x[i], i);
      const D found = Point::template energy<D>(e, x);
      *row++ = found.v;
      for (int i = 0; i < K; ++i) *row++ = found.d[i];
      for (int i = 0; i < K; ++i)
        for (int j = 0; j < K; ++j) *row++ = found.second(i, j);
    });
  }

  // New internal variables.
  static void remember(long n, const double *in, double *out) {
    each<states>(n, in, out, [](const Number *x, Number *row) {
      Number found[1 + states];
      Point::law(x, x, found);
      for (int i = 0; i < states; ++i) row[i] = found[1 + i];
    });
  }

  // Whether the strains have no change.
  static bool held(const double *change) {
    for (int i = 0; i < K * lanes; ++i)
      if (change[i] != 0.0) return false;
    return true;
  }
  // w with its derivatives by the strains and along the changes; T: Lanes, or double where strains are held.
  template <class T> static Dual<Lanes, K> of_both(const T *strain, const Lanes *x) {
    using D = Dual<T, K>;
    D e[K];
    for (int i = 0; i < K; ++i) e[i] = D::variable(strain[i], i);
    return Dual<Lanes, K>(Point::template energy<Dual<Lanes, K>>(e, x));
  }

  // Changes of stress (K, lanes) along changes of what it sees (inputs, lanes).
  __attribute__((flatten)) static void push_stress(long n, const double *in, const double *change, double *out) {
    Lanes x[inputs];
    for (; n--; in += inputs) {
      for (int i = 0; i < inputs; ++i, change += lanes) x[i] = seeded(in[i], change);
      const auto found = held(change - lanes * inputs) ? of_both<double>(in, x) : of_both<Lanes>(x, x);
      for (int i = 0; i < K; ++i, out += lanes)
        for (int l = 0; l < lanes; ++l) out[l] = found.d[i].d[l];
    }
  }
  // Of new internal variables (states, lanes).
  __attribute__((flatten)) static void push_memory(long n, const double *in, const double *change, double *out) {
    Lanes x[inputs], found[1 + states];
    for (; n--; in += inputs) {
      for (int i = 0; i < inputs; ++i, change += lanes) x[i] = seeded(in[i], change);
      Point::law(x, x, found);
      for (int i = 0; i < states; ++i, out += lanes)
        for (int l = 0; l < lanes; ++l) out[l] = found[1 + i].d[l];
    }
  }
};

}  // namespace thinshell
