// The column of two uniform rods with smoothed friction, followed for long: for each lane
// the largest |phi1|, |phi2|, |phi2 - phi1| over the last part of a span. It shares
// nothing with the package: Dormand and Prince's pair of order 5 (J. R. Dormand, P. J.
// Prince, J. Comput. Appl. Math. 6 (1980) 19-26) in scalars, with the C library's
// functions.
#include <cmath>
#include <algorithm>

namespace {

struct Column { double q, tau_s, tau_k, v_stribeck, v_smooth; };

double friction(const Column& c, double u) {
    const double r = u / c.v_stribeck;
    return (c.tau_k + (c.tau_s - c.tau_k) * std::exp(-r * r)) * std::tanh(u / c.v_smooth);
}

void field(const Column& p, const double* y, double* f) {
    const double a = 4.0 / 3, b = 0.5, d = 1.0 / 3;
    const double s = std::sin(y[0] - y[1]), c = std::cos(y[0] - y[1]);
    const double t1 = friction(p, y[2]), t2 = friction(p, y[3] - y[2]);
    const double r1 = p.q * s - 2 * y[0] + y[1] - b * s * y[3] * y[3] - t1 + t2;
    const double r2 = y[0] - y[1] + b * s * y[2] * y[2] - t2;
    const double h = b * c, det = a * d - h * h;
    f[0] = y[2];
    f[1] = y[3];
    f[2] = (d * r1 - h * r2) / det;
    f[3] = (a * r2 - h * r1) / det;
}

const double A[7][6] = {
    {0},
    {1.0 / 5},
    {3.0 / 40, 9.0 / 40},
    {44.0 / 45, -56.0 / 15, 32.0 / 9},
    {19372.0 / 6561, -25360.0 / 2187, 64448.0 / 6561, -212.0 / 729},
    {9017.0 / 3168, -355.0 / 33, 46732.0 / 5247, 49.0 / 176, -5103.0 / 18656},
    {35.0 / 384, 0, 500.0 / 1113, 125.0 / 192, -2187.0 / 6784, 11.0 / 84}};
const double E[7] = {71.0 / 57600, 0, -71.0 / 16695, 71.0 / 1920, -17253.0 / 339200,
                     22.0 / 525, -1.0 / 40};

// The largest size of a cubic over a step, by its ends and where its slope changes sign.
double peak(double g0, double v0, double g1, double v1) {
    double top = std::max(std::fabs(g0), std::fabs(g1));
    if (v0 * v1 < 0) {
        const double c2 = 3 * (g1 - g0) - 2 * v0 - v1, c3 = v0 + v1 - 2 * (g1 - g0);
        double x = v0 / (v0 - v1);
        for (int i = 0; i < 4; i++)
            x -= (v0 + x * (2 * c2 + 3 * x * c3)) / (2 * c2 + 6 * x * c3);
        if (x > 0 && x < 1)
            top = std::max(top, std::fabs(g0 + x * (v0 + x * (c2 + c3 * x))));
    }
    return top;
}

void lane(const Column& p, double* y, double span, double last, double tol, double* out) {
    double t = 0, h = 1e-3, k[7][4];
    out[0] = out[1] = out[2] = 0;
    field(p, y, k[0]);
    while (t < span) {
        h = std::min(h, span - t);
        double z[4], error = 0;
        for (int i = 1; i < 7; i++) {
            for (int j = 0; j < 4; j++) {
                double sum = 0;
                for (int l = 0; l < i; l++) sum += A[i][l] * k[l][j];
                z[j] = y[j] + h * sum;
            }
            field(p, z, k[i]);
        }
        for (int j = 0; j < 4; j++) {
            double e = 0;
            for (int i = 0; i < 7; i++) e += E[i] * k[i][j];
            e *= h / (tol + tol * std::max(std::fabs(y[j]), std::fabs(z[j])));
            error += e * e / 4;
        }
        if (error <= 1) {
            if (t + h > span - last) {
                out[0] = std::max(out[0], peak(y[0], h * k[0][0], z[0], h * k[6][0]));
                out[1] = std::max(out[1], peak(y[1], h * k[0][1], z[1], h * k[6][1]));
                out[2] = std::max(out[2], peak(y[1] - y[0], h * (k[0][1] - k[0][0]),
                                               z[1] - z[0], h * (k[6][1] - k[6][0])));
            }
            t += h;
            for (int j = 0; j < 4; j++) y[j] = z[j], k[0][j] = k[6][j];
        }
        h *= std::min(5.0, std::max(0.2, 0.85 * std::pow(error + 1e-12, -0.1)));
        if (!(h > 1e-12)) break;
    }
}

}  // namespace

// columns (n, 5), states (n, 4; changed to those at the end), spans, lasts (n)
extern "C" void follow(long n, const double* columns, double* states, const double* spans,
                       const double* lasts, double tol, double* amplitudes) {
#pragma omp parallel for schedule(dynamic, 4)
    for (long i = 0; i < n; i++) {
        Column p{columns[5 * i], columns[5 * i + 1], columns[5 * i + 2],
                 columns[5 * i + 3], columns[5 * i + 4]};
        lane(p, states + 4 * i, spans[i], lasts[i], tol, amplitudes + 3 * i);
    }
}
