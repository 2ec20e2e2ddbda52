/* Numbers in text, rounded as Python's `float` rounds them: to the bit. */

#include <float.h>
#include <math.h>
#include <string.h>

#include "kernel.h"

enum { MAX_WORD = 1024, MAX_DIGITS = 19, MAX_POWER = 22 };

/* What a word is. A hard number is one whose nearest double needs long arithmetic. */
typedef enum { NO_NUMBER, NUMBER, HARD_NUMBER } Kind;

typedef struct {
    const unsigned char *at, *end;
    PyThreadState *released;
} Text;

static const double POWERS[MAX_POWER + 1] = {1e0,  1e1,  1e2,  1e3,  1e4,  1e5,  1e6,  1e7,
                                             1e8,  1e9,  1e10, 1e11, 1e12, 1e13, 1e14, 1e15,
                                             1e16, 1e17, 1e18, 1e19, 1e20, 1e21, 1e22};

static int is_blank(unsigned char code)
{
    return code == ' ' || code == '\t' || code == '\v' || code == '\f';
}

static int is_digit(unsigned char code)
{
    return code >= '0' && code <= '9';
}

/* Reads digits as far as they go, behind those already in `digits`. Up to eight are read at once,
   without a branch on how many they are, which no processor foresees (after Lemire 2021, "Number
   parsing at a gigabyte per second"). */
INLINE const unsigned char *read_digits(const unsigned char *at, const unsigned char *end,
                                        uint64_t *digits)
{
    uint64_t found = *digits;
#if defined(__GNUC__) && __BYTE_ORDER__ == __ORDER_LITTLE_ENDIAN__
    static const uint64_t shares[9] = {1,      10,      100,      1000,     10000,
                                       100000, 1000000, 10000000, 100000000};
    while (end - at >= 8) {
        const uint64_t tops = 0x8080808080808080u, pairs = 0x000000ff000000ffu;
        uint64_t word;
        memcpy(&word, at, sizeof word);
        word ^= 0x3030303030303030u;
        uint64_t others = (word | (word + 0x7676767676767676u)) & tops;
        int count = others ? __builtin_ctzll(others) / 8 : 8;
        if (count == 0)
            break;
        word <<= 64 - 8 * count;
        word = 10 * word + (word >> 8);
        word = ((word & pairs) * (100 + (1000000ull << 32))
                + ((word >> 16) & pairs) * (1 + (10000ull << 32))) >> 32;
        found = shares[count] * found + word;
        at += count;
        if (count < 8) {
            *digits = found;
            return at;
        }
    }
#endif
    while (at < end && is_digit(*at))
        found = 10 * found + (*at++ - '0');
    *digits = found;
    return at;
}

#ifdef __SIZEOF_INT128__
/* The double nearest to digits / 10^power, for a power of 1 to 19: the quotient of 128 by 64 bits
   is exact but for a rest, and the rest decides a tie. */
static double divide_exactly(uint64_t digits, int power)
{
    uint64_t divisor = 1;
    for (int k = 0; k < power; k++)
        divisor *= 10;
    int shift = __builtin_clzll(digits), divisor_shift = __builtin_clzll(divisor);
    unsigned __int128 dividend = (unsigned __int128)(digits << shift) << 63;
    divisor <<= divisor_shift;
    uint64_t quotient = (uint64_t)(dividend / divisor), rest = (uint64_t)(dividend % divisor);
    int drop = quotient >> 63 ? 11 : 10;
    uint64_t below = quotient & (((uint64_t)1 << drop) - 1), half = (uint64_t)1 << (drop - 1);
    uint64_t kept = quotient >> drop;
    kept += below > half || (below == half && (rest != 0 || (kept & 1)));
    return ldexp((double)kept, drop - 63 - shift + divisor_shift);
}
#endif

/* Rounds digits times 10^exponent, if double precision or one long division suffices: products and
   quotients of numbers that are exact round once (Clinger 1990). */
static Kind scale(uint64_t digits, int exponent, double *value)
{
    if (digits == 0) {
        *value = 0;
        return NUMBER;
    }
#if FLT_EVAL_METHOD == 0
    if (digits <= (uint64_t)1 << 53 && exponent >= -MAX_POWER && exponent <= MAX_POWER) {
        *value = exponent < 0 ? (double)digits / POWERS[-exponent] : (double)digits * POWERS[exponent];
        return NUMBER;
    }
#endif
#ifdef __SIZEOF_INT128__
    if (exponent < 0 && exponent >= -MAX_DIGITS) {
        *value = divide_exactly(digits, -exponent);
        return NUMBER;
    }
#endif
    return HARD_NUMBER;
}

static int is_nan(const unsigned char *at, const unsigned char *end)
{
    return end - at >= 3 && (at[0] | 32) == 'n' && (at[1] | 32) == 'a' && (at[2] | 32) == 'n';
}

/* Reads a number as far as it goes, without its value where it is hard. */
static Kind read_plain(Text *text, double *value)
{
    const unsigned char *at = text->at, *end = text->end;
    int is_negative = at < end && *at == '-', exponent = 0;
    uint64_t digits = 0;
    at += at < end && ((*at == '-') | (*at == '+'));
    if (is_nan(at, end)) {
        text->at = at + 3;
        *value = is_negative ? -NAN : NAN;
        return NUMBER;
    }
    const unsigned char *first = at, *point = NULL;
    at = read_digits(at, end, &digits);
    Py_ssize_t count = at - first;
    if (at < end && *at == '.') {
        point = ++at;
        at = read_digits(at, end, &digits);
        exponent = (int)(point - at);
        count += at - point;
    }
    if (count == 0 || count > MAX_WORD)
        return NO_NUMBER;
    if (count > MAX_DIGITS)
        while (first < at && (*first == '0' || *first == '.'))
            count -= *first++ == '0';
    if (at < end && (*at | 32) == 'e') {
        int is_small = at + 1 < end && at[1] == '-', power = 0;
        at += 1 + (at + 1 < end && (at[1] == '-' || at[1] == '+'));
        if (at == end || !is_digit(*at))
            return NO_NUMBER;
        while (at < end && is_digit(*at)) {
            power = power < 100000 ? 10 * power + (*at - '0') : power;
            at++;
        }
        exponent += is_small ? -power : power;
    }
    text->at = at;
    Kind kind = count > MAX_DIGITS ? HARD_NUMBER : scale(digits, exponent, value);
    *value *= 1 - 2 * is_negative;
    return kind;
}

/* The value of a hard number by Python's own function, which needs the interpreter. */
static int read_hard(Text *text, const unsigned char *begin, double *value)
{
    char word[MAX_WORD + 1];
    size_t length = (size_t)(text->at - begin);
    if (length > MAX_WORD)
        return 0;
    memcpy(word, begin, length);
    word[length] = 0;
    PyEval_RestoreThread(text->released);
    *value = PyOS_string_to_double(word, NULL, NULL);
    int is_number = !PyErr_Occurred();
    PyErr_Clear();
    text->released = PyEval_SaveThread();
    return is_number;
}

/* Reads one number that is not infinite, as far as it goes; returns whether there is one. */
static int read_double(Text *text, double *value)
{
    const unsigned char *begin = text->at;
    *value = 0;
    Kind kind = read_plain(text, value);
    if (kind == HARD_NUMBER && !read_hard(text, begin, value))
        return 0;
    return kind != NO_NUMBER && !isinf(*value);
}

static int read_integer(Text *text, int64_t *value)
{
    int is_negative = text->at < text->end && *text->at == '-';
    text->at += text->at < text->end && (*text->at == '-' || *text->at == '+');
    const unsigned char *first = text->at;
    uint64_t found = 0;
    text->at = read_digits(first, text->end, &found);
    if (text->at == first || text->at - first > 18)
        return 0; /* 18 digits fit for certain */
    *value = is_negative ? -(int64_t)found : (int64_t)found;
    return 1;
}

/* Reads the words within bounds; returns whether all of them are numbers. */
static int read_words(const unsigned char *data, Py_ssize_t length, const void *bounds, int is_long,
                      Py_ssize_t count, double *doubles, int64_t *integers)
{
    const int64_t *longs = bounds;
    const int32_t *shorts = bounds;
    Text text = {.released = PyEval_SaveThread()};
    int is_valid = 1;
    for (Py_ssize_t k = 0; is_valid && k < count; k++) {
        int64_t begin = is_long ? longs[2 * k] : shorts[2 * k];
        int64_t end = is_long ? longs[2 * k + 1] : shorts[2 * k + 1];
        is_valid = begin >= 0 && begin <= end && end <= length;
        if (is_valid) {
            text.at = data + begin, text.end = data + end;
            is_valid = (doubles ? read_double(&text, doubles + k) : read_integer(&text, integers + k)) &&
                       text.at == text.end;
        }
    }
    PyEval_RestoreThread(text.released);
    return is_valid;
}

PyObject *parse_words(PyObject *module, PyObject *arguments)
{
    Arrays arrays = {.count = 0};
    PyObject *text, *bounds, *results;
    int is_long, has_integers, is_number = 0;
    Py_ssize_t length = ANY, pairs[2] = {ANY, 2};
    (void)module;
    if (!PyArg_ParseTuple(arguments, "OOppO", &text, &bounds, &is_long, &has_integers, &results))
        return NULL;
    const unsigned char *data = take_array(&arrays, text, "text", 'B', READ, 1, &length);
    const void *places = data ? take_array(&arrays, bounds, "bounds", is_long ? 'q' : 'i', READ, 2, pairs) : NULL;
    void *numbers = places ? take_array(&arrays, results, "numbers", has_integers ? 'q' : 'd', WRITE, 1, pairs) : NULL;
    if (numbers != NULL)
        is_number = read_words(data, length, places, is_long, pairs[0],
                               has_integers ? NULL : numbers, has_integers ? numbers : NULL);
    release_arrays(&arrays);
    return numbers ? PyBool_FromLong(is_number) : NULL;
}

/* Reads the three numbers behind a `v`; returns whether they are there. */
static int read_vertex(Text *text, double *position)
{
    for (int k = 0; k < 3; k++) {
        while (text->at < text->end && is_blank(*text->at))
            text->at++;
        if (!read_double(text, position + k))
            return 0;
        if (text->at < text->end && !is_blank(*text->at) && *text->at != '\n' && *text->at != '\r' &&
            *text->at != '#')
            return 0;
    }
    return 1;
}

/* Reads a text whose lines are `count` vertices and others, but no faces; returns whether it is one
   without continued lines, bare returns and binary data, which are left to the other parser. */
static int read_vertices(Text *text, double *positions, Py_ssize_t count)
{
    Py_ssize_t found = 0;
    while (text->at < text->end) {
        while (text->at < text->end && is_blank(*text->at))
            text->at++;
        unsigned char key = text->at < text->end ? *text->at : '\n';
        if (key == 'v' || key == 'f') {
            unsigned char next = text->at + 1 < text->end ? text->at[1] : '\n';
            int is_key = is_blank(next) || next == '\n' || next == '\r' || next == '#';
            if (is_key && (key == 'f' || found == count))
                return 0;
            text->at++;
            if (is_key && !read_vertex(text, positions + 3 * found++))
                return 0;
        }
        if (text->at < text->end && *text->at == '\n') {
            text->at++;
            continue;
        }
        size_t left = (size_t)(text->end - text->at);
        const unsigned char *newline = left ? memchr(text->at, '\n', left) : NULL;
        const unsigned char *stop = newline ? newline : text->end;
        const unsigned char *turn = left ? memchr(text->at, '\r', (size_t)(stop - text->at)) : NULL;
        if (turn && (newline == NULL || turn + 1 != newline))
            return 0;
        text->at = newline ? newline + 1 : text->end;
    }
    return found == count;
}

PyObject *parse_positions(PyObject *module, PyObject *arguments)
{
    Arrays arrays = {.count = 0};
    PyObject *object, *results;
    Py_ssize_t length, size = ANY, places[2] = {ANY, 3};
    int is_read = 0;
    (void)module;
    if (!PyArg_ParseTuple(arguments, "OnO", &object, &length, &results))
        return NULL;
    const unsigned char *data = take_array(&arrays, object, "text", 'B', READ, 1, &size);
    double *positions = data ? take_array(&arrays, results, "positions", 'd', WRITE, 2, places) : NULL;
    if (positions != NULL && length >= 0 && length <= size) {
        Text text = {.at = data, .end = data + length, .released = PyEval_SaveThread()};
        is_read = !memchr(data, 0, (size_t)length) && !memchr(data, '\\', (size_t)length) &&
                  read_vertices(&text, positions, places[0]);
        PyEval_RestoreThread(text.released);
    }
    release_arrays(&arrays);
    return positions ? PyBool_FromLong(is_read) : NULL;
}
