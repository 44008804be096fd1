// Small vectors and matrices, array views and scalar functions, as far as laws use them.
// For g++, clang and NVRTC (C++17); no container and no allocation.
#pragma once

#ifdef __CUDACC_RTC__
#define HUGE_VAL __longlong_as_double(0x7ff0000000000000LL)
#else
#include <cmath>
#endif

#ifdef __CUDACC__
#define THINSHELL_FN __host__ __device__ inline
#else
#define THINSHELL_FN inline
#endif
// Functions that a GPU's compiler keeps apart, so that it is done sooner.
#ifdef __CUDACC_RTC__
#define THINSHELL_APART __noinline__
#else
#define THINSHELL_APART
#endif
#ifdef THINSHELL_ROLLED  // for scalars of many numbers, whose loops are long enough
#define THINSHELL_UNROLL
#elif defined(__CUDACC__) || defined(__clang__)
#define THINSHELL_UNROLL _Pragma("unroll")
#else
#define THINSHELL_UNROLL _Pragma("GCC unroll 12")
#endif

namespace thinshell {

// ---- types ------------------------------------------------------------------------------------------------------

template <bool B, class T = void> struct EnableIf {};
template <class T> struct EnableIf<true, T> { using type = T; };
template <class A, class B> struct Same { static constexpr bool value = false; };
template <class A> struct Same<A, A> { static constexpr bool value = true; };
template <class T> struct Bare { using type = T; };
template <class T> struct Bare<T &> : Bare<T> {};
template <class T> struct Bare<T &&> : Bare<T> {};
template <class T> struct Bare<const T> : Bare<T> {};
template <class T> THINSHELL_FN T &&value_of_type() noexcept;

template <class T> constexpr bool is_integer =
    Same<T, int>::value || Same<T, bool>::value || Same<T, long>::value || Same<T, long long>::value ||
    Same<T, unsigned>::value || Same<T, unsigned long>::value;
template <class T> constexpr bool is_number = is_integer<T> || Same<T, double>::value || Same<T, float>::value;

// Type of the sum of scalars.
template <class... A> struct CommonOf;
template <class A> struct CommonOf<A> { using type = typename Bare<decltype(value_of_type<A>() + value_of_type<A>())>::type; };
template <class A, class B> struct CommonOf<A, B> {
  using type = typename Bare<decltype(value_of_type<A>() + value_of_type<B>())>::type;
};
template <class A, class B, class C, class... D> struct CommonOf<A, B, C, D...> : CommonOf<typename CommonOf<A, B>::type, C, D...> {};
template <class... A> using Common = typename CommonOf<A...>::type;

// Scalar that an argument carries; int where it has none that counts.
template <class T> struct Void { using type = void; };
template <class T, class = void> struct ScalarIn { using type = int; };
template <class T> struct ScalarIn<T, typename EnableIf<is_number<T>>::type> { using type = T; };
template <class T> struct ScalarIn<T *, void> : ScalarIn<typename Bare<T>::type> {};
template <class T, int N> struct ScalarIn<T[N], void> : ScalarIn<typename Bare<T>::type> {};
template <class T> struct ScalarIn<T, typename Void<typename T::Scalar>::type> { using type = typename T::Scalar; };
template <class T> struct OrDouble { using type = T; };
template <> struct OrDouble<int> { using type = double; };
// Scalar of a function with these arguments: every number that the function changes has it.
template <class... A> using Scalar = typename OrDouble<Common<int, typename ScalarIn<typename Bare<A>::type>::type...>>::type;
// Plain floating-point type under a scalar (dual.hpp adds dual numbers).
template <class S> struct RealUnder { using type = S; };
template <class S> using Real = typename RealUnder<S>::type;

template <class... T> struct Tuple;
template <class A> struct Tuple<A> { A a0; };
template <class A, class B> struct Tuple<A, B> { A a0; B a1; };
template <class A, class B, class C> struct Tuple<A, B, C> { A a0; B a1; C a2; };
template <class A, class B, class C, class D> struct Tuple<A, B, C, D> { A a0; B a1; C a2; D a3; };
template <class A, class B, class C, class D, class E> struct Tuple<A, B, C, D, E> { A a0; B a1; C a2; D a3; E a4; };
template <class A, class B, class C, class D, class E, class F> struct Tuple<A, B, C, D, E, F> { A a0; B a1; C a2; D a3; E a4; F a5; };
template <class... T> THINSHELL_FN Tuple<T...> tuple_of(T... values) { return Tuple<T...>{values...}; }

// ---- arrays -----------------------------------------------------------------------------------------------------

// Array in C order that lives elsewhere.
template <class T, int N> struct View {
  using Scalar = typename Bare<T>::type;
  T *data;
  int shape[N];
  template <class... I> THINSHELL_FN View(T *at, I... sizes) : data(at), shape{int(sizes)...} {
    static_assert(sizeof...(I) == N, "one size an axis");
  }
  THINSHELL_FN T &operator[](int i) const { return data[i]; }
  THINSHELL_FN T &operator()(int i) const { return data[i]; }
  THINSHELL_FN T &operator()(int i, int j) const { return data[i * shape[1] + j]; }
  THINSHELL_FN T &operator()(int i, int j, int k) const { return data[(i * shape[1] + j) * shape[2] + k]; }
};

// ---- scalars ----------------------------------------------------------------------------------------------------

#ifdef __CUDACC_RTC__
using ::acos; using ::asin; using ::atan; using ::atan2; using ::ceil; using ::cos; using ::exp; using ::expm1; using ::floor;
using ::log; using ::pow; using ::sin; using ::sqrt; using ::tan; using ::tanh;
#else
using std::acos; using std::asin; using std::atan; using std::atan2; using std::ceil; using std::cos; using std::exp; using std::expm1;
using std::floor; using std::log; using std::pow; using std::sin; using std::sqrt; using std::tan; using std::tanh;
#endif

// Neither infinite nor no number.
THINSHELL_FN bool is_finite(double x) { return x - x == 0.0; }
THINSHELL_FN double infinity() { return HUGE_VAL; }

template <class A, class B> THINSHELL_FN Common<A, B> select(bool which, const A &yes, const B &no) {
  return which ? Common<A, B>(yes) : Common<A, B>(no);
}
template <class T> THINSHELL_FN typename EnableIf<is_number<T>, T>::type abs(const T &x) { return select(x < T(0), -x, x); }
template <class A, class B> THINSHELL_FN Common<A, B> max(const A &a, const B &b) {
  using C = Common<A, B>;
  return select(a < b, C(b), C(a));
}
template <class A, class B> THINSHELL_FN Common<A, B> min(const A &a, const B &b) {
  using C = Common<A, B>;
  return select(b < a, C(b), C(a));
}
template <class A, class B, class... C> THINSHELL_FN auto max(const A &a, const B &b, const C &...c) { return max(max(a, b), c...); }
template <class A, class B, class... C> THINSHELL_FN auto min(const A &a, const B &b, const C &...c) { return min(min(a, b), c...); }
// Python's /, // and %: the quotient of integers is not one, and remainders have the sign of the divisor.
template <class A, class B> THINSHELL_FN auto divide(const A &a, const B &b) {
  if constexpr (is_integer<A> && is_integer<B>) return double(a) / double(b);
  else return a / b;
}
template <class A, class B> THINSHELL_FN auto floor_divide(const A &a, const B &b) {
  if constexpr (is_integer<A> && is_integer<B>) return a / b - ((a % b != 0) && ((a < 0) != (b < 0)));
  else return floor(a / b);
}
template <class A, class B> THINSHELL_FN auto floor_modulo(const A &a, const B &b) { return a - floor_divide(a, b) * b; }
template <int N, class T> THINSHELL_FN T power(const T &x) {
  if constexpr (N < 0) return T(1) / power<-N>(x);
  else if constexpr (N == 0) return T(1);
  else if constexpr (N == 1) return x;
  else if constexpr (N % 2 == 0) { const T half = power<N / 2>(x); return half * half; }
  else return power<N - 1>(x) * x;
}

// ---- matrices and vectors -----------------------------------------------------------------------------------------

template <class T, int R, int C = 1> struct Mat;
template <class T, int N> using Vec = Mat<T, N, 1>;
template <class T> struct IsMat { static constexpr bool value = false; };
template <class T, int R, int C> struct IsMat<Mat<T, R, C>> { static constexpr bool value = true; };
template <class T> using IfScalar = typename EnableIf<!IsMat<T>::value>::type;

template <class T, int R, int C> struct Mat {
  using Scalar = typename ScalarIn<T>::type;
  T a[R * C];

  THINSHELL_FN T &operator[](int i) { return a[i]; }
  THINSHELL_FN const T &operator[](int i) const { return a[i]; }
  THINSHELL_FN T &operator()(int i) { return a[i]; }
  THINSHELL_FN const T &operator()(int i) const { return a[i]; }
  THINSHELL_FN T &operator()(int i, int j) { return a[i * C + j]; }
  THINSHELL_FN const T &operator()(int i, int j) const { return a[i * C + j]; }

  template <class U> THINSHELL_FN Mat &operator=(const Mat<U, R, C> &b) {
    for (int i = 0; i < R * C; ++i) a[i] = b.a[i];
    return *this;
  }

  template <class U> THINSHELL_FN Common<T, U> dot(const Mat<U, R, C> &b) const {
    Common<T, U> out = a[0] * b.a[0];
    THINSHELL_UNROLL for (int i = 1; i < R * C; ++i) out += a[i] * b.a[i];
    return out;
  }
  THINSHELL_FN T norm_sqr() const { return dot(*this); }
  THINSHELL_FN T norm() const { return sqrt(dot(*this)); }
  THINSHELL_FN Mat normalized() const { return (T(1) / norm()) * *this; }
  THINSHELL_FN T sum() const { T out = a[0]; for (int i = 1; i < R * C; ++i) out += a[i]; return out; }
  THINSHELL_FN T max() const { T out = a[0]; for (int i = 1; i < R * C; ++i) out = thinshell::max(out, a[i]); return out; }
  THINSHELL_FN T min() const { T out = a[0]; for (int i = 1; i < R * C; ++i) out = thinshell::min(out, a[i]); return out; }
  template <class U> THINSHELL_FN Vec<Common<T, U>, 3> cross(const Vec<U, 3> &b) const {
    static_assert(R == 3 && C == 1, "the cross product is that of 3-vectors");
    return {{a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]}};
  }
  template <class U, int M> THINSHELL_FN Mat<Common<T, U>, R, M> outer_product(const Vec<U, M> &b) const {
    static_assert(C == 1, "the outer product is that of vectors");
    Mat<Common<T, U>, R, M> out;
    THINSHELL_UNROLL for (int i = 0; i < R; ++i) THINSHELL_UNROLL for (int j = 0; j < M; ++j) out(i, j) = a[i] * b[j];
    return out;
  }
  THINSHELL_FN Mat<T, C, R> transpose() const {
    Mat<T, C, R> out;
    THINSHELL_UNROLL for (int i = 0; i < R; ++i) THINSHELL_UNROLL for (int j = 0; j < C; ++j) out(j, i) = (*this)(i, j);
    return out;
  }
  THINSHELL_FN T trace() const { T out = a[0]; for (int i = 1; i < R; ++i) out += (*this)(i, i); return out; }
  THINSHELL_FN T determinant() const {
    static_assert(R == C && R <= 3, "determinants up to 3 x 3");
    const Mat &m = *this;
    if constexpr (R == 1) return a[0];
    else if constexpr (R == 2) return a[0] * a[3] - a[1] * a[2];
    else return m(0, 0) * (m(1, 1) * m(2, 2) - m(2, 1) * m(1, 2)) - m(1, 0) * (m(0, 1) * m(2, 2) - m(2, 1) * m(0, 2)) +
           m(2, 0) * (m(0, 1) * m(1, 2) - m(1, 1) * m(0, 2));
  }
  THINSHELL_FN Mat inverse() const {
    static_assert(R == C && R >= 2 && R <= 3, "inverses of 2 x 2 and 3 x 3");
    const Mat &m = *this;
    const T scale = T(1) / determinant();
    Mat out;
    if constexpr (R == 2) {
      out = Mat{{a[3] * scale, -a[1] * scale, -a[2] * scale, a[0] * scale}};
    } else {
      for (int i = 0; i < 3; ++i)
        for (int j = 0; j < 3; ++j) {
          const int p = (i + 1) % 3, q = (i + 2) % 3, r = (j + 1) % 3, s = (j + 2) % 3;
          out(j, i) = scale * (m(p, r) * m(q, s) - m(q, r) * m(p, s));
        }
    }
    return out;
  }
};

#define THINSHELL_ELEMENTWISE(OP)                                                                                       \
  template <class A, class B, int R, int C>                                                                             \
  THINSHELL_FN Mat<Common<A, B>, R, C> operator OP(const Mat<A, R, C> &a, const Mat<B, R, C> &b) {                      \
    Mat<Common<A, B>, R, C> out;                                                                                        \
    THINSHELL_UNROLL for (int i = 0; i < R * C; ++i) out.a[i] = a.a[i] OP b.a[i];                                       \
    return out;                                                                                                         \
  }                                                                                                                     \
  template <class A, class B, int R, int C, class = IfScalar<B>>                                                        \
  THINSHELL_FN Mat<Common<A, B>, R, C> operator OP(const Mat<A, R, C> &a, const B &b) {                                 \
    Mat<Common<A, B>, R, C> out;                                                                                        \
    THINSHELL_UNROLL for (int i = 0; i < R * C; ++i) out.a[i] = a.a[i] OP b;                                            \
    return out;                                                                                                         \
  }                                                                                                                     \
  template <class A, class B, int R, int C, class = IfScalar<A>>                                                        \
  THINSHELL_FN Mat<Common<A, B>, R, C> operator OP(const A &a, const Mat<B, R, C> &b) {                                 \
    Mat<Common<A, B>, R, C> out;                                                                                        \
    THINSHELL_UNROLL for (int i = 0; i < R * C; ++i) out.a[i] = a OP b.a[i];                                            \
    return out;                                                                                                         \
  }                                                                                                                     \
  template <class A, int R, int C, class B> THINSHELL_FN Mat<A, R, C> &operator OP##=(Mat<A, R, C> &a, const B &b) {    \
    a = a OP b;                                                                                                         \
    return a;                                                                                                           \
  }
THINSHELL_ELEMENTWISE(+)
THINSHELL_ELEMENTWISE(-)
THINSHELL_ELEMENTWISE(*)
THINSHELL_ELEMENTWISE(/)
#undef THINSHELL_ELEMENTWISE

template <class A, int R, int C> THINSHELL_FN Mat<A, R, C> operator-(const Mat<A, R, C> &a) {
  Mat<A, R, C> out;
  THINSHELL_UNROLL for (int i = 0; i < R * C; ++i) out.a[i] = -a.a[i];
  return out;
}
template <class A, class B, int R, int M, int C>
THINSHELL_FN Mat<Common<A, B>, R, C> matmul(const Mat<A, R, M> &a, const Mat<B, M, C> &b) {
  Mat<Common<A, B>, R, C> out;
  THINSHELL_UNROLL for (int i = 0; i < R; ++i) THINSHELL_UNROLL for (int j = 0; j < C; ++j) {
    Common<A, B> total = a(i, 0) * b(0, j);
    THINSHELL_UNROLL for (int k = 1; k < M; ++k) total += a(i, k) * b(k, j);
    out(i, j) = total;
  }
  return out;
}

// Matrices by their entries; one entry fills all. E: least type of the entries.
template <class E, int R, int C, class... T> THINSHELL_FN auto matrix_of(const T &...entries) {
  static_assert(sizeof...(T) == R * C || sizeof...(T) == 1, "one entry a place, or one for all");
  using Entry = Common<E, T...>;
  Mat<Entry, R, C> out{{Entry(entries)...}};
  if constexpr (sizeof...(T) == 1) for (int i = 1; i < R * C; ++i) out.a[i] = out.a[0];
  return out;
}
template <class T, int N, class... V> THINSHELL_FN Mat<T, N, 1 + int(sizeof...(V))> columns(const Vec<T, N> &first, const V &...more) {
  constexpr int C = 1 + int(sizeof...(V));
  Mat<T, N, C> out;
  const Vec<T, N> all[] = {first, more...};
  for (int i = 0; i < N; ++i) for (int j = 0; j < C; ++j) out(i, j) = all[j][i];
  return out;
}
template <class T, int N> THINSHELL_FN Mat<T, N, N> identity() {
  Mat<T, N, N> out{};
  for (int i = 0; i < N; ++i) out(i, i) = T(1);
  return out;
}

// What a variable that will change starts from: floating-point numbers in the scalar of the function.
template <class S, class T> THINSHELL_FN auto lift(const T &x) {
  if constexpr (is_integer<T>) return x;
  else return S(x);
}
template <class S, class T, int R, int C> THINSHELL_FN auto lift(const Mat<T, R, C> &x) {
  Mat<typename Bare<decltype(lift<S>(x.a[0]))>::type, R, C> out;
  for (int i = 0; i < R * C; ++i) out.a[i] = lift<S>(x.a[i]);
  return out;
}
// Casts: to an integer towards zero, to a floating-point number if it is not one.
template <class T> THINSHELL_FN int to_int(const T &x) { return int(x); }
template <class S, class T> THINSHELL_FN auto to_real(const T &x) { if constexpr (is_integer<T>) return Real<S>(x); else return x; }

}  // namespace thinshell
