/* Vectors of the processor, the functions of a network, and products of small matrices. */

#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#ifdef __AVX512F__
#define LANES 16
#else
#define LANES 8
#endif
#define WIDE (2 * LANES) /* columns of a tile: two vectors */
#define TALL 6           /* rows of a tile: with WIDE columns, twelve registers of sums */
#define ROWS 12          /* rows that go through the horizon together */

typedef float vec __attribute__((vector_size(4 * LANES), aligned(4), may_alias));
typedef int32_t ivec __attribute__((vector_size(4 * LANES), aligned(4), may_alias));

static inline long padded(long columns) { return (columns + WIDE - 1) / WIDE * WIDE; }

static inline vec choose(ivec where, vec yes, vec no)
{
    return (vec)((where & (ivec)yes) | (~where & (ivec)no));
}

/* exp by 2^k times a polynomial on [-ln 2 / 2, ln 2 / 2]: relative error about 1e-7. */
static inline vec exponential(vec x)
{
    const vec zero = {0};
    x = choose(x > 88.0f, zero + 88.0f, choose(x < -87.0f, zero - 87.0f, x));
    const vec shifted = x * 1.44269504f + 12582912.0f; /* rounds to an integer k */
    const vec k = shifted - 12582912.0f;
    const vec f = (x - k * 0.693359375f) + k * 2.12194440e-4f;
    vec p = zero + 1.9875691500e-4f;
    p = p * f + 1.3981999507e-3f;
    p = p * f + 8.3334519073e-3f;
    p = p * f + 4.1665795894e-2f;
    p = p * f + 1.6666665459e-1f;
    p = p * f + 5.0000001201e-1f;
    p = p * (f * f) + f + 1.0f;
    const ivec scale = ((ivec)shifted << 23) + 0x3f800000;
    return p * (vec)scale;
}

static inline vec sigmoid(vec x) { return 1.0f / (1.0f + exponential(-x)); }
static inline vec hyperbolic_tangent(vec x) { return 1.0f - 2.0f / (1.0f + exponential(2.0f * x)); }
static inline vec silu(vec x) { return x * sigmoid(x); }

/* The derivative of `silu`. */
static inline vec silu_slope(vec x)
{
    const vec s = sigmoid(x);
    return s * (1.0f + x * (1.0f - s));
}

static inline vec load(const float *from) { return *(const vec *)from; }
static inline void store(vec value, float *to) { *(vec *)to = value; }

/* right [depth, columns] in strips of WIDE columns, each strip's rows one after the other. */
static void pack(const float *right, long depth, long columns, long row, long column, float *packed)
{
    for (long strip = 0; strip < padded(columns); strip += WIDE)
        for (long k = 0; k < depth; k++)
            for (long j = strip; j < strip + WIDE; j++)
                *packed++ = j < columns ? right[k * row + j * column] : 0.0f;
}

static inline __attribute__((always_inline)) void tile(
    const int rows, long depth, const float *left, long left_row, const float *packed, float *sums,
    long sums_row)
{
    vec a[TALL], b[TALL];
    for (int i = 0; i < rows; i++) {
        a[i] = *(const vec *)(sums + i * sums_row);
        b[i] = *(const vec *)(sums + i * sums_row + LANES);
    }
    for (long k = 0; k < depth; k++) {
        const vec first = *(const vec *)(packed + k * WIDE);
        const vec second = *(const vec *)(packed + k * WIDE + LANES);
        for (int i = 0; i < rows; i++) {
            const float factor = left[i * left_row + k];
            a[i] += factor * first;
            b[i] += factor * second;
        }
    }
    for (int i = 0; i < rows; i++) {
        *(vec *)(sums + i * sums_row) = a[i];
        *(vec *)(sums + i * sums_row + LANES) = b[i];
    }
}

/* sums [rows, columns] += left [rows, depth] · right, which is packed. */
static void product(
    long rows, long depth, long columns, const float *left, long left_row, const float *packed,
    float *sums, long sums_row)
{
    for (long strip = 0; strip < columns; strip += WIDE, packed += depth * WIDE) {
        long i = 0;
        for (; i + TALL <= rows; i += TALL)
            tile(TALL, depth, left + i * left_row, left_row, packed, sums + i * sums_row + strip,
                 sums_row);
        const float *rest = left + i * left_row;
        float *into = sums + i * sums_row + strip;
        switch (rows - i) {
        case 5: tile(5, depth, rest, left_row, packed, into, sums_row); break;
        case 4: tile(4, depth, rest, left_row, packed, into, sums_row); break;
        case 3: tile(3, depth, rest, left_row, packed, into, sums_row); break;
        case 2: tile(2, depth, rest, left_row, packed, into, sums_row); break;
        case 1: tile(1, depth, rest, left_row, packed, into, sums_row); break;
        }
    }
}

static float *zeros(long count)
{
    float *memory = calloc(count + WIDE, sizeof(float));
    if (!memory) abort();
    return memory;
}

static void copy(long count, const float *from, float *to)
{
    memcpy(to, from, count * sizeof(float));
}
