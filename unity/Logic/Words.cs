using System;
using System.Globalization;

namespace Armcell.Logic
{
    /// <summary>Something sent to us that cannot be done; the message says what is wrong with it.</summary>
    public class RefusedException : Exception
    {
        public RefusedException(string reason) : base(reason) { }
    }

    /// <summary>Numbers as armcell writes them, whatever the computer's language.</summary>
    public static class Words
    {
        /// <summary>As many decimals as told.</summary>
        public static string F(double value, int decimals)
        {
            return value.ToString("F" + decimals, CultureInfo.InvariantCulture);
        }

        /// <summary>As many significant digits as told, short.</summary>
        public static string G(double value, int digits = 6)
        {
            if (double.IsPositiveInfinity(value)) return "inf";
            if (double.IsNegativeInfinity(value)) return "-inf";
            if (double.IsNaN(value)) return "nan";
            return value.ToString("G" + digits, CultureInfo.InvariantCulture).ToLowerInvariant();
        }

        public static bool IsFinite(double value)
        {
            return !double.IsNaN(value) && !double.IsInfinity(value);
        }
    }

    /// <summary>A fixed rate of a clock that goes on in steps; no burst after a pause.</summary>
    public class Rate
    {
        readonly double m_Period;
        double m_Next = double.NegativeInfinity;

        /// <param name="hertz">0 or less: never due.</param>
        public Rate(double hertz)
        {
            m_Period = hertz > 0 ? 1.0 / hertz : double.PositiveInfinity;
        }

        /// <summary>Whether it is time again at this time [s] of the clock.</summary>
        public bool Due(double now)
        {
            if (double.IsInfinity(m_Period) || now < m_Next - 1e-9) return false;
            m_Next += m_Period;
            if (!(m_Next > now)) m_Next = now + m_Period; // the first time, and after a pause
            return true;
        }
    }
}
