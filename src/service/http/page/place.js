// Name of the site at a centre, which answers with its own file in place of this one; null at a site.

export const siteAtCentre = null;
