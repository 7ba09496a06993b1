"""Agreement although some agents lie about their values."""
